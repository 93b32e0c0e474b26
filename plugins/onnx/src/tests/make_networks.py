"""Makes the networks of the tests in `networks/`, in the shapes in which trained policies are exported.

Run with any Python that has the package `onnx`: `python make_networks.py`. Every network takes three observed values.
"""

import pathlib

import onnx
from onnx import TensorProto, helper

HERE = pathlib.Path(__file__).parent / "networks"
FLOAT = TensorProto.FLOAT


def save(name, nodes, inputs, outputs, constants=()):
    graph = helper.make_graph(
        nodes,
        name,
        [helper.make_tensor_value_info(label, kind, shape) for label, kind, shape in inputs],
        [helper.make_tensor_value_info(label, kind, shape) for label, kind, shape in outputs],
        [helper.make_tensor(label, FLOAT, shape, values) for label, shape, values in constants],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8, producer_name="")
    onnx.checker.check_model(model)
    HERE.mkdir(exist_ok=True)
    (HERE / f"{name}.onnx").write_bytes(model.SerializeToString())


# Two actions: the first observation plus the second, and twice the third.
SUM = ("weights", [3, 2], [1.0, 0.0, 1.0, 0.0, 0.0, 2.0])
# Four values, the largest that of the index of the largest observation; of equals the first.
VALUES = ("weights", [3, 4], [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def multiply(output):
    return helper.make_node("MatMul", ["observation", "weights"], [output])


# An actor that ends in a tanh, as of SAC, TD3 and DDPG, for any number of observations at once.
save(
    "batched",
    [multiply("sum"), helper.make_node("Tanh", ["sum"], ["action"])],
    [("observation", FLOAT, ["batch", 3])],
    [("action", FLOAT, ["batch", 2])],
    [SUM],
)
# The same for exactly one, without a batch.
save("flat", [multiply("action")], [("observation", FLOAT, [3])], [("action", FLOAT, [2])], [SUM])
# What a whole policy of PPO gives: action, value, logarithm of the probability.
save(
    "three_outputs",
    [
        multiply("action"),
        helper.make_node("ReduceSum", ["observation"], ["value"], keepdims=1),
        helper.make_node("ReduceMax", ["observation"], ["log_probability"], keepdims=0),
    ],
    [("observation", FLOAT, [1, 3])],
    [("action", FLOAT, [1, 2]), ("value", FLOAT, [1, 1]), ("log_probability", FLOAT, [])],
    [SUM],
)
# The values of four discrete actions, as of DQN.
save("values", [multiply("values")], [("observation", FLOAT, ["n", 3])], [("values", FLOAT, ["n", 4])], [VALUES])
# Their index alone, as a whole policy gives it.
save(
    "index",
    [multiply("values"), helper.make_node("ArgMax", ["values"], ["action"], axis=1, keepdims=0)],
    [("observation", FLOAT, [1, 3])],
    [("action", TensorProto.INT64, [1])],
    [VALUES],
)
# Observations as double precision.
save(
    "double",
    [
        helper.make_node("Cast", ["double"], ["observation"], to=FLOAT),
        multiply("action"),
    ],
    [("double", TensorProto.DOUBLE, ["batch", 3])],
    [("action", FLOAT, ["batch", 2])],
    [SUM],
)
# Two inputs: no policy that can be called with an observation.
save(
    "two_inputs",
    [helper.make_node("Add", ["left", "right"], ["action"])],
    [("left", FLOAT, [1, 3]), ("right", FLOAT, [1, 3])],
    [("action", FLOAT, [1, 3])],
)
# Not a number for a negative observation.
save("root", [helper.make_node("Sqrt", ["observation"], ["action"])], [("observation", FLOAT, [1, 3])], [("action", FLOAT, [1, 3])])
