"""Serves one Gymnasium environment to the plugin `gymnasium` over shared memory. Needs gymnasium and numpy, nothing else."""

import json
import mmap
import os
import struct
import sys
import traceback

# The shared block; `protocol.rs` says the same. The first 256 bytes belong to the channel.
REQUEST_NUMBER, ANSWER_NUMBER = 0, 64
COMMAND, STATUS, SEED, REWARD, FLAGS, TEXT_LENGTH, TEXT = (256 + place for place in (0, 4, 8, 16, 24, 28, 32))
NUMBERS = 256 + (1 << 20)
MAKE, RESET, STEP, RENDER = 1, 2, 3, 4
OK, UNFIT, RAISED = 0, 1, 2
TERMINATED, SUCCESS = 2, 4


class Unfit(Exception):
    """What the user must change."""


class Server:
    def __init__(self, block):
        self.block = block
        self.env = None

    def make(self):
        (length,) = struct.unpack_from("=I", self.block, TEXT_LENGTH)
        wanted = json.loads(self.block[TEXT : TEXT + length])
        try:
            import gymnasium
            import numpy
        except ImportError as error:
            raise Unfit(
                f"`python`: {sys.executable} lacks a package ({error}). Install it, `{sys.executable} -m pip install gymnasium`,"
                " or name the interpreter of the virtual environment that has it"
            ) from error
        self.numpy, self.spaces = numpy, gymnasium.spaces
        if wanted["import"]:
            import importlib

            try:
                importlib.import_module(wanted["import"])
            except ImportError as error:
                raise Unfit(f"`import`: {wanted['import']!r} cannot be imported: {error}") from error
        try:
            spec = gymnasium.spec(wanted["id"])
        except gymnasium.error.Error as error:
            raise Unfit(
                f"`id`: {error} If a package of yours registers it, name the package in `import`"
            ) from error
        # A time-out is no end of the world: the host counts the steps, and goes on without a reset.
        time_limit = spec.max_episode_steps
        try:
            self.env = gymnasium.make(
                spec, max_episode_steps=-1, disable_env_checker=True, **self.with_pictures(spec, wanted["kwargs"])
            )
        except (gymnasium.error.DependencyNotInstalled, TypeError) as error:
            raise Unfit(f"{wanted['id']} cannot be made: {type(error).__name__}: {error}") from error
        self.describe(time_limit, gymnasium.__version__)

    def with_pictures(self, spec, kwargs):
        """Environments draw only when asked, but must know from the beginning how."""
        from gymnasium.envs.registration import load_env_creator

        creator = spec.entry_point if callable(spec.entry_point) else load_env_creator(spec.entry_point)
        modes = getattr(creator, "metadata", {}).get("render_modes") or []
        return ({"render_mode": "rgb_array"} if "rgb_array" in modes else {}) | kwargs

    def describe(self, time_limit, version):
        observed, done = self.env.observation_space, self.env.action_space
        self.observed = observed
        if isinstance(observed, self.spaces.Discrete):
            observation = {"kind": "discrete", "length": int(observed.n)}
            bounds = []
        else:
            if not observed.is_np_flattenable:
                raise Unfit(f"`id`: the observation space {observed} has no fixed number of values")
            flat = self.spaces.flatten_space(observed)
            observation = {"kind": "box", "length": int(flat.shape[0])}
            bounds = [flat.low, flat.high]
        if isinstance(done, self.spaces.Discrete):
            action = {"kind": "discrete", "length": int(done.n)}
        elif isinstance(done, self.spaces.Box):
            if not done.is_bounded():
                raise Unfit(
                    f"`id`: the action space {done} has infinite bounds; give it finite ones, for example with"
                    " gymnasium.wrappers.RescaleAction in an environment of your own that `import` registers"
                )
            action = {"kind": "box", "length": int(done.low.size)}
            bounds += [done.low.ravel(), done.high.ravel()]
        else:
            raise Unfit(
                f"`id`: the action space is {done}; an action here is a Box or Discrete. Wrap the environment with"
                " gymnasium.wrappers.TransformAction in one of your own that `import` registers"
            )
        self.view(0, sum(part.size for part in bounds))[:] = self.numpy.concatenate(
            [part.astype(self.numpy.float32) for part in bounds] or [[]]
        )
        action_values = action["length"] if action["kind"] == "box" else 1
        self.actions = self.view(0, action_values)
        self.observation = self.view(action_values, observation["length"])
        self.write_text(
            json.dumps(
                {"observation": observation, "action": action, "time_limit": time_limit, "version": version}
            )
        )

    def view(self, first, count):
        start = NUMBERS + 4 * first
        if start + 4 * count > len(self.block):
            raise Unfit(
                f"`id`: {first + count} numbers do not fit into the shared memory, which has room for"
                f" {(len(self.block) - NUMBERS) // 4}"
            )
        return self.numpy.frombuffer(self.block, self.numpy.float32, count, start)

    def reset(self):
        (seed,) = struct.unpack_from("=Q", self.block, SEED)
        # Some environments seed generators that take no more than 31 bits.
        observation, _ = self.env.reset(seed=seed % 2**31)
        self.show(observation)

    def step(self):
        space = self.env.action_space
        if isinstance(space, self.spaces.Discrete):
            action = space.dtype.type(int(self.actions[0]) + int(space.start))
        else:
            # The bounds may be finer than the numbers that travel.
            action = self.actions.reshape(space.shape).astype(space.dtype).clip(space.low, space.high)
        observation, reward, terminated, _, info = self.env.step(action)
        self.show(observation)
        success = info.get("is_success", info.get("success", False))
        flags = (TERMINATED if terminated else 0) | (SUCCESS if success else 0)
        struct.pack_into("=dI", self.block, REWARD, float(reward), flags)

    def show(self, observation):
        if isinstance(self.observed, self.spaces.Box):
            values = self.numpy.asarray(observation).ravel()
        else:
            values = self.spaces.flatten(self.observed, observation)
        if values.size != self.observation.size:
            raise ValueError(
                f"the observation has {values.size} values; its space {self.observed} has {self.observation.size}"
            )
        self.observation[:] = values

    def render(self):
        if self.env.render_mode != "rgb_array":
            raise Unfit(f"drawing: the environment's render_mode is {self.env.render_mode!r}, not 'rgb_array'")
        picture = self.numpy.asarray(self.env.render())
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != self.numpy.uint8:
            raise Unfit(f"drawing: a picture of {picture.dtype} and shape {picture.shape} is not height × width × 3 bytes")
        height, width, _ = picture.shape
        start = NUMBERS + 4 * (self.actions.size + self.observation.size)
        if start + picture.size > len(self.block):
            raise Unfit(f"drawing: a picture of {width} × {height} does not fit into the shared memory")
        self.block[start : start + picture.size] = picture.tobytes()
        self.write_text(json.dumps({"width": width, "height": height}))

    def write_text(self, text):
        data = text.encode(errors="replace")[-(NUMBERS - TEXT) :]
        struct.pack_into("=I", self.block, TEXT_LENGTH, len(data))
        self.block[TEXT : TEXT + len(data)] = data

    def answer(self):
        (command,) = struct.unpack_from("=I", self.block, COMMAND)
        status = OK
        try:
            {MAKE: self.make, RESET: self.reset, STEP: self.step, RENDER: self.render}[command]()
        except Unfit as error:
            status = UNFIT
            self.write_text(str(error))
        except Exception:
            status = RAISED
            self.write_text(traceback.format_exc(limit=-4).rstrip())
        struct.pack_into("=I", self.block, STATUS, status)


def main():
    memory, bell, length = map(int, os.environ["SHIELD_WORKER_CHANNEL"].split(","))
    block = mmap.mmap(memory, length)
    server = Server(block)
    while os.read(bell, 1):
        server.answer()
        struct.pack_into("=I", block, ANSWER_NUMBER, struct.unpack_from("=I", block, REQUEST_NUMBER)[0])
        os.write(bell, b"\0")
    if server.env is not None:
        server.env.close()


main()
