"""Builds the wheel: maturin, and beside its library the plugins that a shield is made of.

`pip install --config-settings build-args="--profile dev" ./shield-python` builds quickly and runs slowly.
"""

import json
import os
import pathlib
import shlex
import shutil
import subprocess

import maturin
from maturin import (  # noqa: F401
    build_sdist,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

HERE = pathlib.Path(__file__).resolve().parent.parent
PLUGINS = [
    "ddpg",
    "td3",
    "sac",
    "crossq",
    "ddqn",
    "tabular-q",
    "undo-probability",
    "ensemble-threshold",
    "uncertainty",
    "linear-constraints",
    "deadline-latch",
    "near-start",
    "calibrated-start",
    "success-critic",
    "tabular-success",
]


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    bring_plugins(config_settings)
    return maturin.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_editable(wheel_directory, config_settings=None, metadata_directory=None):
    bring_plugins(config_settings)
    return maturin.build_editable(wheel_directory, config_settings, metadata_directory)


def bring_plugins(config_settings):
    command = [os.environ.get("CARGO", "cargo"), "build", "--message-format", "json-render-diagnostics"]
    command += ["--manifest-path", str(HERE.parent / "Cargo.toml"), "--profile", profile(config_settings)]
    command += [part for name in PLUGINS for part in ("--package", name)]
    built = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    folder = HERE / "python/shield/plugins"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for line in built.stdout.splitlines():
        message = json.loads(line)
        if message["reason"] == "compiler-artifact" and "cdylib" in message["target"]["crate_types"]:
            for path in message["filenames"]:
                without_line_numbers(shutil.copy2(path, folder))
    missing = len(PLUGINS) - len(list(folder.iterdir()))
    if missing:
        raise RuntimeError(f"cargo built {missing} plugins fewer than were named")


def without_line_numbers(library):
    """Makes a library a third as large. A machine without `strip` ships it as it is."""
    if shutil.which("strip"):
        subprocess.run(["strip", "--strip-debug", library], check=True)


def profile(config_settings):
    """The profile that maturin is given, so that both are built alike."""
    arguments = (config_settings or {}).get("build-args", [])
    if isinstance(arguments, str):
        arguments = shlex.split(arguments)
    for argument, value in zip(arguments, arguments[1:]):
        if argument == "--profile":
            return value
    return "release"
