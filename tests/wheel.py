"""Trial of a wheel as a user meets it: a fresh environment, no compiler, the first tutorial to its figure.

The program needs nothing but Python, because it runs before anything is installed.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
TUTORIAL = REPOSITORY / "docs" / "start" / "your_log.md"
#: Programs that the tutorial's commands may use, besides those of the environment.
PROGRAMS = ("sh", "head", "rm", "sed")
COMPILERS = ("cc", "gcc", "clang", "c99", "cmake", "ninja")
#: Packages of the tests that pmfid itself does not need.
TEST_PACKAGES = ("pytest", "pytest-timeout", "hypothesis", "pandas")
BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```", re.MULTILINE | re.DOTALL)
#: What pmfid's own wheel must not contain.
UNWANTED = re.compile(r"(^|/)(tests?|studies|benchmarks|docs|examples)/|\.(pyx|pxd|pxi|pyc|o)$")

#: What the metadata must contain.
NEEDED = ("licenses/LICENSE", "licenses/.*uPlot-LICENSE.txt", "sboms/pmfid.cdx.json")


def list_blocks(page: str) -> list[tuple[str, str]]:
    """Return language and text of each block of a page, in order."""
    return [(found[1], found[2]) for found in BLOCK.finditer(page)]


def find_wheel(folder: Path, python: str) -> Path:
    """Return the wheel in a folder for an interpreter. Raises SystemExit if there is none."""
    code = (
        'import sys, sysconfig as s; print(s.get_config_var("py_version_nodot"), s.get_config_var("Py_GIL_DISABLED"))'
    )
    version, free = subprocess.check_output([python, "-c", code], text=True).split()
    tag = f"cp{version}-cp{version}{'t' if free == '1' else ''}"
    found = sorted(folder.glob(f"pmfid-*-{tag}-*.whl"))
    if not found:
        raise SystemExit(f"no wheel of {tag} in {folder}: make wheel PYTHON={python}")
    return found[-1]


def check_contents(wheel: Path) -> None:
    """Raise SystemExit if a wheel contains tests or sources of Cython, or no licences, or no list of parts."""
    names = zipfile.ZipFile(wheel).namelist()
    if unwanted := [name for name in names if UNWANTED.search(name)]:
        raise SystemExit(f"{wheel.name} contains {', '.join(unwanted)}")
    for end in NEEDED:
        if not any(re.search(rf"^[^/]*\.dist-info/{end}$", name) for name in names):
            raise SystemExit(f"{wheel.name} has no {end}")


def make_environment(folder: Path, python: str) -> dict[str, str]:
    """Make a virtual environment, and return the variables of a shell that sees it and no compiler."""
    subprocess.run([python, "-m", "venv", folder / "venv"], check=True)
    programs = folder / "programs"
    programs.mkdir()
    for name in PROGRAMS:
        (programs / name).symlink_to(str(shutil.which(name)))
    path = f"{folder / 'venv' / 'bin'}:{programs}"
    assert not [name for name in COMPILERS if shutil.which(name, path=path)]
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "CC", "VIRTUAL_ENV"))}
    return kept | {"PATH": path, "MPLBACKEND": "agg"}


def run_tutorial(folder: Path, variables: dict[str, str]) -> None:
    """Run the blocks of the tutorial in a folder. Python's blocks are one program, which ends with a figure."""
    programs = []
    for language, text in list_blocks(TUTORIAL.read_text(encoding="utf-8")):
        if language == "sh":
            subprocess.run(["sh", "-ec", text], cwd=folder, env=variables, check=True, stdout=subprocess.DEVNULL)
        else:
            programs.append(text)
    program = "\n".join([*programs, 'figure.savefig("figure.png")', 'print(pmfid.__file__, result["mass"])'])
    subprocess.run(["python", "-c", program], cwd=folder, env=variables, check=True)
    assert (folder / "figure.png").stat().st_size > 10_000


def try_wheel(dist: Path, python: str, tests: list[str], extras: list[str], pins: Path | None) -> None:
    """Install a wheel, time the way to the first figure, and run tests against the installed package.

    `pins` are the versions of all dependencies. Without pins, the versions are the newest.
    """
    wheel = find_wheel(dist, python)
    check_contents(wheel)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        variables = make_environment(folder, python)
        pip = [folder / "venv" / "bin" / "python", "-m", "pip", "--quiet", "--disable-pip-version-check"]
        start, cpu = time.monotonic(), os.times()
        wanted = [f"{wheel}[{','.join(extras)}]" if extras else wheel]
        # Without a compiler, a package that comes only as sources must be pure Python.
        options = (
            ["--prefer-binary", "-r", pins] if pins else ["--prefer-binary"] if extras else ["--only-binary=:all:"]
        )
        subprocess.run([*pip, "install", *options, *wanted], env=variables, check=True)
        installed = time.monotonic()
        run_tutorial(folder, variables)
        end, used = time.monotonic(), os.times()
        seconds = used.children_user + used.children_system - cpu.children_user - cpu.children_system
        print(
            f"{wheel.name}: pip install {installed - start:.1f} s, tutorial to its figure {end - installed:.1f} s, "
            f"processor {seconds:.1f} s",
            flush=True,
        )
        if tests:
            options = ["-c", pins] if pins else []
            subprocess.run([*pip, "install", *options, *TEST_PACKAGES], env=variables, check=True)
            program = ["python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not long", *tests]
            variables = variables | {"PATH": f"{variables['PATH']}:{os.environ['PATH']}"}
            subprocess.run(
                [folder / "venv" / "bin" / program[0], *program[1:]], cwd=REPOSITORY, env=variables, check=True
            )


def main() -> None:
    """Try the wheels of a folder with each of several interpreters."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dist", type=Path)
    parser.add_argument("pythons", nargs="+")
    parser.add_argument("--tests", nargs="*", default=[])
    parser.add_argument("--extras", nargs="*", default=[])
    parser.add_argument("--pins", type=Path)
    arguments = parser.parse_args(sys.argv[1:])
    for python in arguments.pythons:
        try_wheel(arguments.dist.resolve(), python, arguments.tests, arguments.extras, arguments.pins)


if __name__ == "__main__":
    main()
