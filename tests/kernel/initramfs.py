"""The guest's whole world as one archive: busybox, kernel modules, Python, the packages that fly, this checkout.

No file of the host is shared with the guest: a wait for one would make its virtual time leap.
"""

import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
MODULES = ("vcan", "can-raw", "sch_netem")
SITE = "/site"
_FLYING = (
    "jaxmpc.cli",
    "deploy.cli.run",
    "deploy.loop.watchdog_process",
    "deploy.twin.cli",
    "deploy.twin.server",
    "deploy.twin.twin",
    "deploy.flight.replay",
    "can.interfaces.socketcan",
    "mujoco",
)
_LEFT_OUT = ("test", "tests", "idlelib", "tkinter", "turtledemo", "ensurepip", "site-packages", "config-*", "mjx")
_LEFT_OUT_FILES = ("*.opt-?.pyc", "*.a", "*.pyi", "*.h")


def build(folder: Path, kernel: Path, controller: Path, settings: Mapping[str, object]) -> Path:
    """The archive of a kernel; takes some 15 s and 250 MB.

    Args:
        folder: Empty, for the tree and the archive.
        kernel: Unpacked package `linux-image-…`.
        controller: A frozen one.
        settings: Variables of the guest's environment.
    """
    tree = folder / "tree"
    for name in ("bin", "sbin", "modules.d", SITE.strip("/")):
        (tree / name).mkdir(parents=True)
    _modules(tree, kernel)
    shutil.copy2(_found("busybox"), tree / "bin/busybox")
    for tool in ("ip", "tc"):
        shutil.copy2(_found(tool), tree / "sbin" / tool)
    python = Path(sys._base_executable).resolve()  # type: ignore[attr-defined]
    _same(tree, python)
    library = Path(sys.base_prefix) / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}"
    _copy(library, tree / str(library).lstrip("/"))
    for package in _packages():
        _copy(package, tree / SITE.strip("/") / package.name)
    for name in ("jaxmpc", "deploy", "tests/kernel"):
        _copy(ROOT / name, tree / str(ROOT / name).lstrip("/"))
    shutil.copy2(controller, tree / "controller.npz")
    command = ["cc", "-O2", "-shared", "-fPIC", "-o", str(tree / "dilate.so"), str(HERE / "dilate.c")]
    subprocess.run(command, check=True)
    shutil.copy2(HERE / "init.sh", tree / "init")
    (tree / "init").chmod(0o755)
    variables = {"ROOT": ROOT, "PYTHON": python, "PYTHONPATH": f"{ROOT}:{SITE}", "OMP_NUM_THREADS": 1}
    variables |= {"PYTHONUNBUFFERED": 1, "PATH": "/sbin:/bin", **settings}
    (tree / "settings").write_text("".join(f'export {key}="{value}"\n' for key, value in variables.items()))
    for library in _libraries(path for path in tree.rglob("*") if _is_program(path)):
        _same(tree, library)
    archive = folder / "initramfs"
    names = "\0".join(sorted(str(path.relative_to(tree)) for path in tree.rglob("*"))).encode()
    with archive.open("wb") as out:
        packing = ["cpio", "--null", "--create", "--format=newc", "--quiet", "--owner=0:0"]
        subprocess.run(packing, input=names, stdout=out, cwd=tree, check=True)
    shutil.rmtree(tree)
    return archive


def version_of(kernel: Path) -> str:
    """Version of an unpacked kernel package."""
    return next((kernel / "boot").glob("vmlinuz-*")).name.removeprefix("vmlinuz-")


def _modules(tree: Path, kernel: Path) -> None:
    """Copy the modules and what they need, in the order in which they load."""
    base, version = kernel, version_of(kernel)
    if not (base / "lib/modules" / version).exists():
        base = kernel / "usr"
    subprocess.run([_found("depmod"), "-b", str(base), version], check=True)
    lines = []
    for name in MODULES:
        show = [_found("modprobe"), "-d", str(base), "-S", version, "--show-depends", name]
        found = subprocess.run(show, check=True, capture_output=True, text=True).stdout
        lines += [Path(line.split()[1]) for line in found.splitlines() if line.startswith("insmod ")]
    loaded = list(dict.fromkeys(lines))
    for path in loaded:
        shutil.copy2(path, tree / "modules.d" / path.name)
    (tree / "modules").write_text("".join(f"/modules.d/{path.name}\n" for path in loaded))


def _packages() -> list[Path]:
    """What a twin and a run import from outside this checkout and Python, with the libraries beside it."""
    program = (
        f"import importlib, sys; [importlib.import_module(name) for name in {_FLYING!r}]; "
        "print(*sorted({getattr(each, '__file__', None) or '' for each in sys.modules.values()}), sep='\\n')"
    )
    found = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, cwd=ROOT)
    tops = set()
    for line in found.stdout.splitlines():
        site, inside, name = line.partition("/site-packages/")
        if inside:
            top = Path(site, "site-packages", name.partition("/")[0])
            tops |= {top, top.with_name(f"{top.name}.libs")}
    return sorted(top for top in tops if top.exists())


def _copy(source: Path, target: Path) -> None:
    if source.is_dir():
        left_out = shutil.ignore_patterns(*_LEFT_OUT, *_LEFT_OUT_FILES)
        shutil.copytree(source, target, ignore=left_out, symlinks=True)
    else:
        shutil.copy2(source, target)


def _same(tree: Path, path: Path) -> None:
    """Copy a file to the place that it has here."""
    target = tree / str(path).lstrip("/")
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, target)


def _is_program(path: Path) -> bool:
    return path.is_file() and not path.is_symlink() and (".so" in path.name or path.stat().st_mode & 0o100 > 0)


def _libraries(programs: Iterable[Path]) -> list[Path]:
    """The shared libraries that programs load, as the host's loader finds them."""
    found: set[Path] = set()
    for program in programs:
        said = subprocess.run(["ldd", str(program)], capture_output=True, text=True, check=False).stdout
        for path in re.findall(r"(/\S+) \(0x", said):
            if SITE.strip("/") not in Path(path).parts and Path(path).exists():
                found.add(Path(path))
    return sorted(found)


def _found(tool: str) -> str:
    path = shutil.which(tool, path="/usr/sbin:/sbin:/usr/bin:/bin")
    assert path is not None, tool  # `__main__` has looked
    return path
