"""Makes cart.onnx and cart.pt, a finished policy for the cart of `mujoco/cliff-cart` in ONNX and in TorchScript, and home.onnx, its way home.

A spring towards the goal or the start, with little damping, as a network of one layer with a tanh at its end, in the form in which
Stable-Baselines3's actors are exported. Run it with any Python that has the packages `onnx` and `torch`: `python cart.py`.
"""

import pathlib

import onnx
import torch
from onnx import TensorProto, helper

# What the cart observes: position x, height, pitch, and the velocity of each.
OBSERVATION = 6
GOAL = 0.9
STIFFNESS, DAMPING = 6.0, 2.0

weights = [0.0] * OBSERVATION
weights[0], weights[3] = -STIFFNESS, -DAMPING
for name, place in (("cart", GOAL), ("home", 0.0)):
    graph = helper.make_graph(
        [
            helper.make_node("Gemm", ["observation", "weights", "bias"], ["push"]),
            helper.make_node("Tanh", ["push"], ["action"]),
        ],
        name,
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", OBSERVATION])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", 1])],
        [
            helper.make_tensor("weights", TensorProto.FLOAT, [OBSERVATION, 1], weights),
            helper.make_tensor("bias", TensorProto.FLOAT, [1], [STIFFNESS * place]),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8, producer_name="")
    onnx.checker.check_model(model)
    pathlib.Path(__file__).with_name(f"{name}.onnx").write_bytes(model.SerializeToString())

layer = torch.nn.Linear(OBSERVATION, 1)
with torch.no_grad():
    layer.weight.copy_(torch.tensor([weights]))
    layer.bias.fill_(STIFFNESS * GOAL)
network = torch.nn.Sequential(layer, torch.nn.Tanh()).requires_grad_(False)
torch.jit.script(network).save(pathlib.Path(__file__).with_suffix(".pt"))
