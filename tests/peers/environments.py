"""Compares our robots with models that nobody here wrote: Gymnasium's and the DeepMind control suite's.

Usage: environments.py FOLDER SHIELD
FOLDER holds what the test `export_for_peers` of mujoco-robots writes: <robot>.xml, the model without gravity and contacts, and <robot>.csv, its
free motion. SHIELD is the program. Exit code 0 if everything agrees.
"""

import logging
import os
import re
import subprocess
import sys
import time
from pathlib import Path

# Nothing is drawn: without a display, the suite's own choice would only warn.
os.environ.setdefault("MUJOCO_GL", "disabled")

import dm_control.suite
import gymnasium
import mujoco
import numpy as np

MOTION_TOLERANCE = 1e-6
SPEED_GOAL = 1.3


def gymnasium_model(name):
    return lambda: gymnasium.make(name).unwrapped.model


def suite_model():
    xml, assets = dm_control.suite.ball_in_cup.get_model_and_assets()
    return mujoco.MjModel.from_xml_string(xml.decode(), assets)


PEERS = {
    "half-cheetah": gymnasium_model("HalfCheetah-v5"),
    "cliff-cheetah": gymnasium_model("HalfCheetah-v5"),
    "walker": gymnasium_model("Walker2d-v5"),
    "cliff-walker": gymnasium_model("Walker2d-v5"),
    "inverted-pendulum": gymnasium_model("InvertedPendulum-v5"),
    "ball-in-cup": suite_model,
}


def at_rest(model):
    """The model in its default pose. What is compared there does not depend on where a model puts the frames of its bodies."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def inertias(model):
    """3 × 3 about each body's centre of mass, along the axes of the world: independent of the order of the principal axes."""
    axes = at_rest(model).ximat.reshape(-1, 3, 3)
    return np.einsum("bij,bj,bkj->bik", axes, model.body_inertia, axes)[1:]


# Body 0 is the world. What is not said of a joint without limits is not compared.
QUANTITIES = {
    "masses": lambda m: m.body_mass[1:],
    "centres of mass": lambda m: at_rest(m).xipos[1:],
    "inertias": inertias,
    "places of hinges": lambda m: at_rest(m).xanchor[m.jnt_type == mujoco.mjtJoint.mjJNT_HINGE],
    "joint kinds, axes": lambda m: np.column_stack([m.jnt_type, at_rest(m).xaxis]),
    "joint limits": lambda m: np.where(m.jnt_limited[:, None], m.jnt_range, np.inf),
    "stiffness": lambda m: m.jnt_stiffness,
    "damping": lambda m: m.dof_damping,
    "armature": lambda m: m.dof_armature,
    "gears": lambda m: m.actuator_gear,
    "control ranges": lambda m: m.actuator_ctrlrange,
    "tendon limits": lambda m: m.tendon_range,
}


def difference(ours, theirs):
    """The largest difference; infinite if the shapes differ or a limit exists on one side only."""
    if ours.shape != theirs.shape:
        return np.inf
    differs = ours != theirs
    return float(np.max(np.abs(ours[differs] - theirs[differs]), initial=0.0))


def motion_difference(theirs, recorded):
    """How far their model moves from what ours did, under the same actions; both without gravity and contacts."""
    theirs.opt.gravity[:] = 0
    theirs.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(theirs)
    farthest = 0.0
    for row in recorded:
        data.ctrl[:] = row[: theirs.nu]
        seconds, state = row[theirs.nu], row[theirs.nu + 1 :]
        while data.time < seconds - theirs.opt.timestep / 2:
            mujoco.mj_step(theirs, data)
        farthest = max(farthest, difference(state, np.concatenate([data.qpos, data.qvel])))
    return farthest, float(np.max(np.abs(recorded[:, theirs.nu + 1 :])))


def compare_models(folder):
    failed = 0
    print(f"{'robot':<18} {'quantity':<24} {'largest difference':>18}  {'allowed':>8}")

    def line(robot, quantity, found, allowed):
        nonlocal failed
        is_fine = found <= allowed
        failed += not is_fine
        print(f"{robot:<18} {quantity:<24} {found:>18.1e}  {allowed:>8.0e}  {'' if is_fine else 'DIFFERS'}")

    for robot, peer in PEERS.items():
        ours, theirs = mujoco.MjModel.from_xml_path(str(folder / f"{robot}.xml")), peer()
        for quantity, of in QUANTITIES.items():
            line(robot, quantity, difference(of(ours), of(theirs)), 1e-8)
        recorded = np.loadtxt(folder / f"{robot}.csv", delimiter=",", ndmin=2)
        farthest, largest = motion_difference(theirs, recorded)
        line(robot, f"{len(recorded)} steps of free motion", farthest, MOTION_TOLERANCE)
        if len(recorded) != 200 or largest < 0.1:
            failed += 1
            print(f"{robot}: {len(recorded)} steps, values up to {largest}: not what is to be compared")
    return failed


def gymnasium_speed(steps=10_000):
    environment = gymnasium.make("HalfCheetah-v5")
    environment.reset(seed=0)
    low, high = environment.action_space.low, environment.action_space.high
    actions = np.random.default_rng(0).uniform(low, high, (100, len(low))).astype(np.float32)
    begun = time.perf_counter()
    for step in range(steps):
        _, _, terminated, truncated, _ = environment.step(actions[step % len(actions)])
        if terminated or truncated:
            environment.reset()
    return steps / (time.perf_counter() - begun)


def our_speed(shield):
    command = [shield, "env", "bench", "mujoco/half-cheetah", "--rounds", "1"]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return float(re.search(r"(\d+) steps/s", output)[1])


def compare_speeds(shield):
    """In turn, so that both meet the same machine; the best of each counts. Printed, never asserted."""
    rounds = [(our_speed(shield), gymnasium_speed()) for _ in range(5)]
    ours, theirs = (max(column) for column in zip(*rounds))
    print(f"\nhalf-cheetah, one thread, best of 5: ours through the plugin {ours:.0f} steps/s, Gymnasium {theirs:.0f} steps/s")
    print(f"ratio {ours / theirs:.2f} (goal: at least {SPEED_GOAL})")


def main():
    # Gymnasium's cheetah uses an attribute that MuJoCo calls out of date.
    logging.disable(logging.WARNING)
    folder, shield = Path(sys.argv[1]), sys.argv[2]
    failed = compare_models(folder)
    compare_speeds(shield)
    print(f"\n{failed} differences" if failed else "\nno differences")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
