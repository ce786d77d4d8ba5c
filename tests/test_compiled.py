"""Compiled kernels on disk: whatever is wrong with them, what they compute is right."""

import errno
import importlib.util
import os
import random
import shutil
import subprocess
import sys
import warnings

import pytest

import comove._compiled
from comove.errors import ComoveWarning

numba = pytest.importorskip("numba")
caching = sys.modules[comove._compiled.CACHING]

KERNEL = """
import numba

@numba.njit(cache=True)
def twice(x):
    return x + x
"""


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """Load the kernel as a new process would: from the files beside its source."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")  # which NUMBA_CACHE_DIR may have set
    (tmp_path / "kernel.py").write_text(KERNEL)

    def load(name="comove.kernel_for_tests"):
        spec = importlib.util.spec_from_file_location(name, tmp_path / "kernel.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.twice

    return load


def kept(folder, suffix):
    (file,) = (folder / "__pycache__").glob(f"*{suffix}")
    return file


def hits(function):
    return sum(function.stats.cache_hits.values())


def test_what_is_whole_is_loaded(kernel):
    assert kernel()(4) == 8
    again = kernel()
    assert again(4) == 8 and hits(again) == 1


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.slow
def test_files_that_are_damaged_are_made_anew(kernel, tmp_path, suffix):
    assert kernel()(4) == 8
    file = kept(tmp_path, suffix)
    whole, rng = file.read_bytes(), random.Random(0)
    spoilt = [b"", b"\0" * 100, whole[: len(whole) // 2], rng.randbytes(len(whole)), b"\x80\x04.", whole[:-1]]
    for _ in range(40):
        at = rng.randrange(len(whole))
        spoilt.append(whole[:at] + bytes([whole[at] ^ (1 << rng.randrange(8))]) + whole[at + 1 :])
    for data in spoilt:
        file.write_bytes(data)
        assert kernel()(4) == 8
        again = kernel()
        assert again(4) == 8 and hits(again) == 1
    file.unlink()
    assert kernel()(4) == 8


def test_nobody_gets_the_code_of_another_signature(kernel, tmp_path):
    """Two processes that compile two signatures at once both call theirs the first; the last of each file stays."""
    assert kernel()(4) == 8
    code = kept(tmp_path, ".nbc").read_bytes()
    shutil.rmtree(tmp_path / "__pycache__")
    assert kernel()(0.5) == 1.0
    kept(tmp_path, ".nbc").write_bytes(code)
    again = kernel()
    assert again(0.5) == 1.0 and hits(again) == 0


def test_who_needs_one_signature_imports_nothing_of_the_others(kernel, tmp_path, monkeypatch):
    (tmp_path / "points.py").write_text(
        "import typing\n\nPoint = typing.NamedTuple('Point', [('x', float)])\n"
    )
    (tmp_path / "kernel.py").write_text(KERNEL.replace("x + x", "2 * x[0]"))
    monkeypatch.syspath_prepend(tmp_path)
    point = importlib.import_module("points").Point(1.5)
    assert kernel()((4,)) == 8 and kernel()(point) == 3
    monkeypatch.delitem(sys.modules, "points")
    again = kernel()
    assert again((4,)) == 8 and hits(again) == 1 and "points" not in sys.modules
    again = kernel()
    assert again(point) == 3 and hits(again) == 1


def test_without_a_folder_to_keep_them_kernels_are_compiled_and_that_is_said_once(kernel, monkeypatch):
    def nowhere(*_):
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(caching.FunctionCache, "_impl_class", nowhere)
    monkeypatch.setattr(comove._compiled, "_told", False)
    with pytest.warns(
        ComoveWarning, match="every start takes as long as the first: let NUMBA_CACHE_DIR name"
    ) as told:
        one, other = kernel(), kernel()
    assert len(told) == 1
    assert one(4) == other(4) == 8
    assert one.stats.cache_path is None
    with pytest.raises(RuntimeError, match="no locator"):
        kernel("kernel_of_another_package")


def test_a_full_disk_keeps_nothing_and_hinders_nothing(kernel, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(caching.IndexDataCacheFile, "_open_for_write", full)
    assert kernel()(4) == 8
    with pytest.raises(OSError, match="No space left"):
        kernel("kernel_of_another_package")(4)


def test_kernels_of_others_are_left_alone(kernel):
    assert kernel("kernel_of_another_package")(4) == 8
    again = kernel("kernel_of_another_package")
    assert again(4) == 8 and hits(again) == 1
    assert type(again._cache._cache_file) is caching.IndexDataCacheFile


@pytest.mark.parametrize("order", ["import numba, comove", "import comove, numba"])
def test_it_does_not_matter_who_is_imported_first(order):
    code = f"{order}\nimport sys; print(sys.modules['numba.core.caching'].FunctionCache.__init__.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("begin_guarded\n", "")


def test_importing_comove_imports_no_numba():
    code = "import comove, sys; print([name for name in sys.modules if name.startswith('numba')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("[]\n", "")


@pytest.mark.parametrize("turns", [1, 5])
@pytest.mark.slow
def test_two_processes_compile_into_one_empty_folder(tmp_path, turns):
    """Both compute the same, every time; the third process finds what they have left whole."""
    (tmp_path / "kernel.py").write_text(KERNEL)
    code = (
        "import sys, importlib.util, comove\n"
        "spec = importlib.util.spec_from_file_location('comove.kernel_for_tests', sys.argv[1])\n"
        "module = importlib.util.module_from_spec(spec)\nspec.loader.exec_module(module)\n"
        "sys.stdin.read()\n"
        "print(*[module.twice(x) for x in eval(sys.argv[2])], sum(module.twice.stats.cache_hits.values()))"
    )

    def start(values, folder):
        return subprocess.Popen(
            [sys.executable, "-c", code, tmp_path / "kernel.py", values],
            env={**os.environ, "NUMBA_CACHE_DIR": str(folder)},
            **dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE),
            text=True,
        )

    for turn in range(turns):
        both = [start("[1, 0.5, 1j]", tmp_path / str(turn)), start("[1j, 1, 0.5]", tmp_path / str(turn))]
        for process in both:
            process.stdin.close()
        assert [process.stdout.read().split()[:3] for process in both] == [
            ["2", "1.0", "2j"],
            ["2j", "2", "1.0"],
        ]
        assert [process.stderr.read() for process in both] == ["", ""]
        assert [process.wait() for process in both] == [0, 0]
    out, err = start("[1, 0.5, 1j]", tmp_path / "0").communicate()
    assert out.split()[:3] == ["2", "1.0", "2j"] and err == ""


def test_warnings_are_not_needed_for_what_works(kernel):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert kernel()(4) == 8
