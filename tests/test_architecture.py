"""Rules of the structure: imports point down, the surface is listed, the command starts fast, the kernel is pure."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

import pmfid
from tests.patience import PATIENCE

PACKAGE = Path(pmfid.__file__).parent
REPOSITORY = Path(__file__).parents[1]
CSRC = REPOSITORY / "csrc"

KERNELS = {"_estimate", "_stage", "_kernel32", "_kernel64", "kernel"}
SHARED = {"elementary", "errors", "types", "findings", "status", "presentation", "durable", "units", "threads"}
GROUND = SHARED | KERNELS
FILTERS = GROUND | {"models", "encoder", "edge_times"}
FIT = {"errors", "types", "findings", "models", "threads", "_body"}
ESTIMATORS = FILTERS | {"filters", "linear", "fit"}
DIAGNOSTICS = ESTIMATORS | {"estimators"}
CONFIG = DIAGNOSTICS | {"diagnostics", "monitor"}
RECORDS = CONFIG | {"config", "io"}
PIPELINE = RECORDS | {"records", "design"}
WINGS = PIPELINE | {"pipeline", "export"}
#: Package -> the packages that it may import besides itself; "pmfid" is the top `__init__`.
MAY_IMPORT: dict[str, set[str]] = {
    "errors": set(),
    "types": set(),
    "findings": set(),
    "status": {"kernel", "findings"},
    "units": {"errors"},
    "lazy_imports": {"errors"},
    "threads": set(),
    "presentation": {"errors", "lazy_imports"},
    "_estimate": {"errors", "presentation", "status"},
    "_arrays": set(),
    "_stage": {"_arrays"},
    "_body": set(),
    "fit": FIT,
    "durable": {"errors"},
    "elementary": {"types"},
    "_kernel32": {"_kernel64"},
    "_kernel64": {"_arrays", "_estimate"},
    "kernel": {"elementary", "errors", "pmfid", "_kernel32", "_kernel64"},
    "models": GROUND,
    "encoder": GROUND,
    "edge_times": {"errors", "types"},
    "filters": FILTERS,
    "linear": {"errors", "types", "presentation", "_stage", "fit"},
    "io": {"errors", "types"},
    "estimators": ESTIMATORS,
    "diagnostics": DIAGNOSTICS,
    "config": CONFIG,
    "records": RECORDS,
    "monitor": DIAGNOSTICS | {"lazy_imports"},
    "testing": DIAGNOSTICS,
    "simulation": {"edge_times", "elementary", "errors", "types", "lazy_imports"},
    "design": {"errors", "findings", "fit", "lazy_imports", "models", "presentation", "types"},
    "actuators": {"_body", "errors", "findings", "fit", "io", "presentation", "records", "types"},
    "export": DIAGNOSTICS | {"pmfid"},
    "pipeline": PIPELINE,
    "stream": WINGS,
    "service": WINGS | {"stream"},
    "fleet": WINGS | {"stream", "lazy_imports", "pmfid"},
    "report": WINGS | {"actuators", "fleet"},
    "cli": WINGS | {"actuators", "stream", "service", "fleet", "report", "simulation", "pmfid"},
    "pmfid": WINGS | {"fleet", "lazy_imports"},
}

PUBLIC = re.findall(
    r"\w+",
    """
    Along BCLS BCRLS Drive EdgeFit Encoder Equation EquationModel Estimate Experiment Finding Fit Fleet IV Known LS
    MotionFit NotIdentifiableError PmfidError Process REdge RIV RLS Result SRIVC Square Status Stribeck Term
    TermSearch Track Tracks TransferFunction UsageError Validation Wave check export_firmware friction_curve
    identify quantize sample_edges search_terms validate
""",
)

SLOW_TO_IMPORT = {
    *("numpy", "scipy", "pydantic", "polars", "matplotlib", "rich"),
    *("starlette", "uvicorn", "paho", "prometheus_client"),
    *("pyspark", "py4j", "pyarrow", "pandas"),
}

COMPILER = shutil.which("cc")
C_WARNINGS = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wdouble-promotion"]
C_FLAGS = ["-std=c99", "-Wvla", *C_WARNINGS, "-ffp-contract=off", "-fsyntax-only"]


# --- imports point down -----------------------------------------------------------------------------------------------


def room_of(parts: tuple[str, ...]) -> str:
    """Return the package of a module from its path or name below `pmfid`."""
    return parts[0] if parts else "pmfid"


def python_of(path: Path) -> str:
    """Return text that `ast` can parse; of Cython keep only the imports, on their own lines."""
    text = path.read_text(encoding="utf-8")
    if path.suffix not in (".pyx", ".pxd"):
        return text
    lines = (line.strip().replace("cimport", "import") for line in text.splitlines())
    return "\n".join(line if re.match(r"(import|from)\s+[\w.]+", line) else "" for line in lines)


@cache
def nodes_of(path: Path) -> list[ast.AST]:
    """Return all nodes of a file that can import."""
    kinds = (ast.Import, ast.ImportFrom, ast.Name, ast.Attribute)
    return [node for node in ast.walk(ast.parse(python_of(path))) if isinstance(node, kinds)]


def modules_in(node: ast.AST, package: tuple[str, ...]) -> Iterator[str]:
    """Yield the full names that a node imports; a computed name gives a name of `importlib`."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        start = package[: len(package) + 1 - node.level] if node.level else ()
        base = ".".join([*start, *([node.module] if node.module else [])])
        # in `from pmfid import x` only x decides, because the top package has no layer
        yield from (f"{base}.{alias.name}" for alias in node.names)
    elif isinstance(node, ast.Name | ast.Attribute):
        name = node.id if isinstance(node, ast.Name) else node.attr
        if name in ("import_module", "__import__"):
            yield "importlib.import_module"


def rooms_imported(path: Path, root: Path) -> Iterator[tuple[int, str]]:
    """Yield (line, package) of every import of `pmfid` in a file, at any depth; a computed import gives `?`."""
    package = (root.name, *path.relative_to(root).parent.parts)
    for node in nodes_of(path):
        for name in modules_in(node, package):
            parts = tuple(name.split("."))
            if name == "importlib.import_module":
                yield getattr(node, "lineno", 0), "?"
            elif parts[0] == root.name:
                room = room_of(parts[1:])
                yield getattr(node, "lineno", 0), room if room in MAY_IMPORT else "pmfid"


def source_files(root: Path) -> list[Path]:
    return sorted(path for suffix in ("py", "pyi", "pyx", "pxd") for path in root.rglob(f"*.{suffix}"))


def violations(root: Path) -> list[str]:
    """Return the imports that the table does not allow, and the files outside the packages of the table."""
    found = []
    for path in source_files(root):
        inside = path.relative_to(root)
        room = room_of(tuple(part for part in inside.with_suffix("").parts if part != "__init__"))
        if room not in MAY_IMPORT:
            found.append(f"{inside}: room {room} is not in the table; give it a line")
            continue
        allowed = MAY_IMPORT[room] | {room} | ({"?"} if room in ("pmfid", "lazy_imports") else set())
        for line, imported in sorted(rooms_imported(path, root)):
            if imported not in allowed:
                found.append(f"{inside}:{line}: {room} imports {imported}")
    return found


@pytest.mark.parametrize("root", sorted({PACKAGE, REPOSITORY / "src" / "pmfid"}), ids=lambda path: path.parent.name)
def test_imports_point_down(root: Path) -> None:
    assert len(source_files(root)) > 20
    assert violations(root) == []


def test_every_room_of_the_table_exists() -> None:
    source = REPOSITORY / "src" / "pmfid"
    files = source_files(source)
    present = {path.stem for path in source.iterdir() if path.is_dir() or path in files}
    assert set(MAY_IMPORT) - {"pmfid"} <= present


def module_of(path: Path, root: Path) -> str:
    """Return the full name of the module in a file."""
    parts = path.relative_to(root.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_between_modules(root: Path) -> dict[str, set[str]]:
    """Return the modules of `pmfid` that each module imports, at any depth, also only for types.

    The top `__init__` is left out, because it loads a name on demand.
    """
    files = {module_of(path, root): path for path in source_files(root) if path.suffix != ".pyi"}
    del files[root.name]
    graph: dict[str, set[str]] = {}
    for module, path in files.items():
        package = (root.name, *path.relative_to(root).parent.parts)
        named = [name for node in nodes_of(path) for name in modules_in(node, package)]
        found = {name if name in files else name.rpartition(".")[0] for name in named}
        graph[module] = found & set(files) - {module}
    return graph


@pytest.mark.parametrize("root", [PACKAGE, REPOSITORY / "studies"], ids=lambda path: path.name)
def test_no_imports_run_in_a_circle(root: Path) -> None:
    graph = imports_between_modules(root)
    assert sum(map(len, graph.values())) > 20
    assert list(TopologicalSorter(graph).static_order())  # raises CycleError with the circle


def test_the_picture_of_the_layers_is_that_of_the_imports() -> None:
    from tests.layers import PAGE, packages, page_with, picture, reduced

    graph = packages()
    text = PAGE.read_text(encoding="utf-8")
    assert page_with(text, picture(reduced(graph))) == text, "run python -m tests.layers"
    assert len(graph) <= 24
    assert sum(map(len, reduced(graph).values())) <= 60


def test_what_kind_of_plant_it_is_is_asked_in_three_files() -> None:
    """In other files, code for one kind of plant belongs to an object of that kind (`Plant`, `Kind`)."""
    asked = re.compile(r"equation\.process\b|\.process else|if self\.process:")
    found = {path.name for path in source_files(PACKAGE) if asked.search(path.read_text(encoding="utf-8"))}
    assert found == {"equation.py", "plants.py", "srivc.py"}


BAD_FILTER = """\
import numpy as np
from pmfid.errors import UsageError
from pmfid.config.axis import Axis
import pmfid.report.html
from pmfid import simulation, __version__
from ..estimators import base
from .. import report
from .network import Network
from . import chain
def late():
    from pmfid.simulation.drive import quantize
    import importlib
    return importlib.import_module("pmfid.cli.main")
if TYPE_CHECKING:
    from pmfid.cli import main
"""


def test_the_checker_finds_what_it_is_for(tmp_path: Path) -> None:
    root = tmp_path / "pmfid"
    (root / "filters").mkdir(parents=True)
    (root / "filters" / "bad.py").write_text(BAD_FILTER)
    (root / "attic.py").write_text("")
    (root / "_kernel64.pyx").write_text("cimport numpy as cnp\ncdef int x\nfrom pmfid.encoder cimport Encoder\n")
    (root / "simulation.py").write_text("from pmfid.errors import UsageError\nfrom pmfid.status import Status\n")
    (root / "__init__.py").write_text("from importlib import import_module\nimport_module('pmfid.encoder')\n")
    lines = ["3: {} config", "4: {} report", "5: {} pmfid", "5: {} simulation", "6: {} estimators", "7: {} report"]
    lines += ["11: {} simulation", "13: {} ?", "15: {} cli"]
    assert violations(root) == [
        "_kernel64.pyx:3: _kernel64 imports encoder",
        "attic.py: room attic is not in the table; give it a line",
        *("filters/bad.py:" + line.format("filters imports") for line in lines),
        "simulation.py:2: simulation imports status",
    ]


# --- the public surface -----------------------------------------------------------------------------------------------


def test_the_public_names_are_these() -> None:
    assert pmfid.__all__ == PUBLIC
    assert dir(pmfid) == PUBLIC


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_name_imports_and_has_its_own_docstring(name: str) -> None:
    doc = getattr(pmfid, name).__doc__ or ""
    assert len(doc.split()) >= 3
    assert not doc.startswith(f"{name}("), "this is the text that dataclass writes where there is none"


@pytest.mark.parametrize("package", ["pmfid.design", "pmfid.fleet", "pmfid.monitor", "pmfid.simulation"])
def test_the_doors_of_the_wings_open(package: str) -> None:
    room = import_module(package)
    assert room.__all__
    assert set(room.__all__) <= set(dir(room))
    documented = [value for value in (getattr(room, name) for name in room.__all__) if callable(value)]
    assert all(len((value.__doc__ or "").split()) >= 3 for value in documented)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = room.no_such_name


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = pmfid.no_such_name


def modules_after(statement: str) -> set[str]:
    """Return the names in `sys.modules` of a fresh interpreter after a statement."""
    program = f"{statement}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=PATIENCE)
    return set(json.loads(run.stdout))


def test_the_command_starts_without_the_heavy_libraries() -> None:
    loaded = modules_after("import pmfid.cli.main")
    assert "pmfid.cli.main" in loaded
    assert {name.partition(".")[0] for name in loaded} & SLOW_TO_IMPORT == set()
    assert "numpy" in modules_after("import pmfid.encoder"), "the list of modules would not show it"


def test_identify_imports_scipy_only_where_it_is_used() -> None:
    loaded = modules_after("import pmfid.pipeline.identify")
    assert "pmfid.pipeline.identify" in loaded
    assert "scipy" not in loaded, "a quarter of the time of a short record"


NUMERIC = {"numpy", "scipy"}
TABLES = NUMERIC | {"pydantic", "pydantic_core", "polars"}
#: Package -> the libraries that the import of its modules needs; all other libraries of OUTSIDE may be absent.
NEEDS = {
    **dict.fromkeys(["simulation", "kernel", "models", "filters", "linear", "estimators", "diagnostics"], NUMERIC),
    **dict.fromkeys(["monitor", "testing", "io", "design", "actuators"], NUMERIC),
    **dict.fromkeys(["config", "records", "stream", "pipeline"], TABLES),
    "export": NUMERIC | {"jinja2"},
    "report": TABLES | {"jinja2", "matplotlib"},
}
OUTSIDE = SLOW_TO_IMPORT | {"click", "highspy", "jinja2", "pydantic_core", "fastexcel", "h5py", "mcap"}
ALONE = """
import importlib, pkgutil, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent!r}:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Absent())
for name in {rooms!r}:
    room = importlib.import_module("pmfid." + name)
    for place in pkgutil.walk_packages(room.__path__, room.__name__ + "."):
        importlib.import_module(place.name)
"""


@pytest.mark.parametrize("needs", sorted({tuple(sorted(needs)) for needs in NEEDS.values()}), ids=" ".join)
def test_a_room_needs_no_library_of_those_above(needs: tuple[str, ...]) -> None:
    rooms = [room for room in NEEDS if NEEDS[room] == set(needs)]
    program = ALONE.format(absent=OUTSIDE - set(needs), rooms=rooms)
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE)
    assert run.returncode == 0, run.stderr


def test_the_way_to_the_estimate_of_a_drive_needs_no_library_of_filters() -> None:
    """scipy.signal imports scipy.stats, which took a third of the time of `pmfid identify`."""
    loaded = modules_after("import pmfid.pipeline.identify, pmfid.estimators.registry, pmfid.diagnostics.drives")
    assert "pmfid.estimators.iv" in loaded
    assert not {"scipy.signal", "scipy.stats"} & loaded


def test_the_package_imports_nothing_of_its_own_until_asked() -> None:
    assert {name for name in modules_after("import pmfid") if name.startswith("pmfid.")} == {"pmfid.lazy_imports"}
    assert "pmfid.models.drive" in modules_after("from pmfid import Drive")


# --- the kernel -------------------------------------------------------------------------------------------------------


def bare(source: str) -> str:
    """Return C without comments and character constants."""
    return re.sub(r"/\*.*?\*/|//[^\n]*|\"(?:\\.|[^\"\\])*\"|'(?:\\.|[^'\\])*'", " ", source, flags=re.DOTALL)


def mutable_objects(source: str) -> list[str]:
    """Return the objects at file scope, and the static ones at any scope, that are not const, functions or types."""
    code = re.sub(
        r"#ifdef __cplusplus\n.*?#endif", "", bare(source), flags=re.DOTALL
    )  # remove the braces of its linkage
    code = re.sub(r"^\s*#(?:[^\n]*\\\n)*[^\n]*", "", code, flags=re.MULTILINE)
    static = [match.strip() for match in re.findall(r"\bstatic\b[^;{(=]*(?=[;{=])", code)]
    while (flat := re.sub(r"\{[^{}]*\}", " @ ", code)) != code:
        code = flat
    code = re.sub(r"\)\s*@", ");", code)  # a function ends with its body
    statements = [" ".join(statement.split()) for statement in code.split(";")]
    declared = [s for s in statements if not re.match(r"typedef\b|(enum|struct|union)\b[\w ]*@?$|$", s)]
    outside = [s for s in declared if "(" not in s.partition("=")[0] or "(*" in s]
    # const must stand after the last star, because a pointer to const can itself change
    return sorted({s for s in static + outside if "const" not in s.partition("=")[0].rpartition("*")[2]})


def libc_calls(source: str) -> list[str]:
    return re.findall(r"\b(?:malloc|calloc|realloc|free|alloca)\b", bare(source))


def includes(source: str) -> set[str]:
    return set(re.findall(r"^\s*#\s*include\s*[<\"]([^>\"]+)", source, flags=re.MULTILINE))


KERNEL = sorted(path.name for path in CSRC.iterdir() if path.suffix in (".c", ".h", ".inl"))


def test_each_test_file_imports() -> None:
    """A test file that cannot be imported would fail only in `make test`, minutes later."""
    for path in sorted((REPOSITORY / "tests").rglob("test_*.py")):
        with suppress(pytest.skip.Exception):  # a module without its library
            import_module(".".join(path.relative_to(REPOSITORY).with_suffix("").parts))


def test_the_kernel_is_there() -> None:
    assert {"pmf.h", "pmf_step.c"} <= set(KERNEL)


@pytest.mark.parametrize("name", KERNEL)
def test_kernel_has_no_heap_no_globals_no_libc(name: str) -> None:
    source = (CSRC / name).read_text(encoding="ascii")
    assert libc_calls(source) == []
    assert mutable_objects(source) == []
    own = {
        "pmf.h": {"many/pmf_lanes.h", "pmf_redge_axis.h"},
        "pmf_recursion.c": {"pmf_algebra.inl", "pmf_forgetting.inl", "pmf_innovations.inl"},
        "pmf_encoder.c": {"pmf_misread.inl"},
        "pmf_guard.c": {"pmf_outlier.h"},
        "pmf_outlier.c": {"pmf_outlier.h"},
        "pmf_step.c": {"pmf_late.inl", "pmf_steps.inl", "pmf_bytes.inl"},
        "pmf_auxiliary.c": {"pmf_shapes.inl"},
    }
    assert includes(source) <= {"stdint.h", "pmf.h", "pmf_internal.h", "pmf_sizes.h"} | own.get(name, set())


@pytest.mark.parametrize("path", sorted([*CSRC.glob("*/*.[ch]"), *CSRC.glob("*/*.inl")]), ids=lambda path: path.name)
def test_what_stands_beside_the_kernel_needs_no_heap_no_globals_no_libc(path: Path) -> None:
    source = path.read_text(encoding="ascii")
    assert libc_calls(source) == []
    assert mutable_objects(source) == []


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler cc on this machine")
@pytest.mark.parametrize("precision", ["-UPMF_FLOAT32", "-DPMF_FLOAT32"], ids=["float64", "float32"])
def test_kernel_compiles_without_a_warning(precision: str) -> None:
    sources = [str(CSRC / name) for name in KERNEL if name.endswith(".c")]
    run = subprocess.run(
        [str(COMPILER), *C_FLAGS, precision, *sources], capture_output=True, text=True, timeout=PATIENCE
    )
    assert run.returncode == 0, run.stderr
