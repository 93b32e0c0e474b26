"""Lets a torch wheel for graphics cards be imported where there is none, without NVIDIA's libraries: python without_cuda.py TORCH/lib

torch's CUDA part is linked against a dozen libraries of several GB that a processor never calls. Each that is missing is replaced by a small one with
the same name, the same versions of symbols, and functions that end the process. Needs cc, nm and readelf.
"""

import pathlib
import re
import subprocess
import sys

# Real ones lie beside: torch calls them to find out that there is no graphics card.
REAL = ("libcudart.so.13", "libcupti.so.13")
# Where the version of a symbol does not name its library.
HOME = {"NVSHMEM": "libnvshmem_host.so.3", "": "libnccl.so.2"}


def output(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def survey(folder):
    """Libraries that are needed, symbols (with versions) that are undefined, and symbols that are defined."""
    needed, undefined, defined = set(), {}, set()
    for library in folder.glob("*.so*"):
        needed |= set(re.findall(r"Shared library: \[(.*?)\]", output("readelf", "-dW", library)))
        for line in output("nm", "-D", library).splitlines():
            *_, kind, symbol = line.split()
            name, _, version = symbol.partition("@")
            if kind == "U":
                undefined.setdefault(name, version.strip("@"))
            elif kind not in "wv":
                defined.add(name)
    return needed, undefined, defined


def stand_in(folder, library, symbols, version):
    source, script = folder / "stand_in.c", folder / "stand_in.map"
    source.write_text("".join(f"void {name}(void) {{ __builtin_trap(); }}\n" for name in symbols))
    command = ["cc", "-w", "-shared", "-fPIC", "-fno-builtin", source, f"-Wl,-soname,{library}", "-o", folder / library]
    if version:
        script.write_text(f"{version} {{ global: *; }};\n")
        command.append(f"-Wl,--version-script={script}")
    subprocess.run(command, check=True)
    source.unlink()
    script.unlink(missing_ok=True)


def main(folder):
    needed, undefined, defined = survey(folder)
    of_cuda = re.compile(r"lib(cu|nv|nccl)")
    missing = [name for name in needed if of_cuda.match(name) and name not in REAL and not (folder / name).exists()]
    names = [name for name in undefined if re.match("cu|nv|nccl|Nv", name) and name not in defined]
    for library in missing:
        own = [name for name in names if HOME.get(undefined[name], undefined[name]) == library]
        version = next((undefined[name] for name in own if undefined[name]), None)
        stand_in(folder, library, own, version)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]))
