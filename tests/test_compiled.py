"""Compiled kernels on disk: whatever is wrong with them, what they compute is right."""

import errno
import importlib.util
import os
import random
import shutil
import subprocess
import sys
import threading
import warnings
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from numba import config
from numba.core import caching
from numba.core.errors import TypingError

from comove.compiled import cache, kernels, libraries
from comove.compiled.cache import fingerprint
from comove.errors import ComoveWarning

KERNEL = """
from comove.compiled import kernel

@kernel
def twice(x):
    return x + x
"""
CALLER = """
import numpy as np

from comove.compiled import kernel

@kernel
def inner(x, values):
    if x < 0.0:
        raise ValueError("below zero")
    return x * values

@kernel
def through(call, x, values):
    return call(x, values) + 1.0

@kernel(nogil=True)
def outer(x, values=None):
    return inner(x, np.ones(3)) if values is None else inner(x, values)
"""

SUM = """
from comove.compiled import kernel

@kernel
def add(values, sums):
    for i in range(values.shape[0]):
        for k in range(values.shape[1]):
            sums[i, k] += values[i, k]
"""


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """Load the kernel as a new process would: from the files beside its source."""
    monkeypatch.setattr(config, "CACHE_DIR", "")  # which NUMBA_CACHE_DIR may have set
    (tmp_path / "kernel.py").write_text(KERNEL)

    def load():
        spec = importlib.util.spec_from_file_location("kernel_for_tests", tmp_path / "kernel.py")
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "kernel_for_tests", module)
        spec.loader.exec_module(module)
        return module.twice

    return load


@pytest.fixture
def calling(tmp_path, monkeypatch):
    """Load kernels that call each other as a new process would, in files that are as they were told to be."""
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.syspath_prepend(tmp_path)

    def load(source=CALLER):
        file = tmp_path / "calling_for_tests.py"
        if not file.exists() or file.read_text() != source:
            file.write_text(source)
        sys.modules.pop("calling_for_tests", None)
        return importlib.import_module("calling_for_tests")

    yield load
    sys.modules.pop("calling_for_tests", None)


def kept(folder, suffix):
    """Files of a kernel on disk: of code, that of the callee and that of its entry; one index."""
    return sorted((folder / "__pycache__").glob(f"*{suffix}"))


def said(folder, code, *arguments):
    """Words that code prints in a process of its own, which finds modules and what is compiled in a folder."""
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": "",
        "PYTHONDONTWRITEBYTECODE": "1",  # Python knows a changed file by its size and the second of its change
        "PYTHONPATH": os.pathsep.join([str(folder), *sys.path]),
    }
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def hits(function):
    return sum(function.stats.cache_hits.values())


def test_what_is_whole_is_loaded(kernel):
    assert kernel()(4) == 8
    again = kernel()
    assert again(4) == 8 and hits(again) == 1


@pytest.mark.parametrize("suffix", [".nbi", ".1.nbc", ".2.nbc"])
@pytest.mark.slow
def test_files_that_are_damaged_are_made_anew(kernel, tmp_path, suffix):
    assert kernel()(4) == 8
    (file,) = kept(tmp_path, suffix)
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
    codes = [file.read_bytes() for file in kept(tmp_path, ".nbc")]
    shutil.rmtree(tmp_path / "__pycache__")
    assert kernel()(0.5) == 1.0
    for file, code in zip(kept(tmp_path, ".nbc"), codes, strict=True):
        file.write_bytes(code)
    again = kernel()
    assert again(0.5) == 1.0 and hits(again) == hits(again.callee) == 0


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

    monkeypatch.setattr(cache.KernelCache, "_impl_class", nowhere)
    monkeypatch.setattr(cache, "_told", False)
    with pytest.warns(
        ComoveWarning, match="every start takes as long as the first: let NUMBA_CACHE_DIR name"
    ) as told:
        one, other = kernel(), kernel()
        assert one(4) == other(4) == 8
    assert len(told) == 1
    assert one.stats.cache_path is None


def test_a_full_disk_keeps_nothing_and_hinders_nothing(kernel, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(caching.IndexDataCacheFile, "_open_for_write", full)
    assert kernel()(4) == 8


@pytest.mark.parametrize("large", [0, 10**9], ids=["called where it lies", "part of its callers"])
def test_a_kernel_computes_the_same_however_it_is_called(calling, monkeypatch, large):
    """By Python, by another kernel, as an argument; compiled, and found on disk."""
    monkeypatch.setattr(libraries, "LARGE", large)
    values = np.array([1.0, 2.0])
    for found in (0, 1):
        module = calling()
        assert module.outer(2.0).tolist() == [2.0, 2.0, 2.0]
        assert module.outer(2.0, values).tolist() == [2.0, 4.0]
        assert module.inner(2.0, values).tolist() == [2.0, 4.0]
        assert module.through(module.inner, 2.0, values).tolist() == [3.0, 5.0]
        for call in (module.inner, module.outer, partial(module.through, module.inner)):
            with pytest.raises(ValueError, match="below zero"):
                call(-1.0, values)
        assert [hits(call) for call in (module.outer, module.inner, module.through)] == [
            2 * found,
            found,
            found,
        ]


@pytest.mark.slow
def test_a_large_kernel_is_called_anew_when_its_source_has_changed(tmp_path):
    (tmp_path / "caller.py").write_text(
        "from comove.compiled import kernel\n\nimport calling_for_tests\n\n"
        "@kernel\ndef more(x):\n    return calling_for_tests.inner(x, x) + 1.0\n"
    )
    code = "from comove.compiled import libraries\nlibraries.LARGE = 0\nfrom caller import more\nprint(more(3.0))"

    def run(inner):
        (tmp_path / "calling_for_tests.py").write_text(CALLER.replace("x * values", inner))
        return said(tmp_path, code)

    assert run("x * values") == ["10.0"]
    assert run("x * values + 0.5") == ["10.5"]
    assert run("int(x)") == ["4.0"]  # another type comes back


@pytest.mark.slow
def test_who_is_compiled_with_what_is_on_disk_loads_what_that_calls(tmp_path):
    """Each process compiles one caller more; a last one has nothing but what they have left."""
    (tmp_path / "chain.py").write_text(
        "from comove.compiled import kernel\n\n"
        "@kernel\ndef lowest(x):\n    return x + 1.0\n\n"
        "@kernel\ndef middle(x):\n    return 2.0 * lowest(x)\n\n"
        "@kernel\ndef upper(x):\n    return middle(x) + 0.5\n\n"
        "@kernel\ndef highest(x):\n    return upper(x) - 3.0\n"
    )
    code = (
        "import sys\nfrom comove.compiled.libraries import KernelLibrary\n"
        "KernelLibrary._is_called = lambda library: 'lowest' in library.name\n"
        "import chain\nprint(getattr(chain, sys.argv[1])(3.0))"
    )
    for _ in range(2):
        for name, value in {"middle": "8.0", "upper": "8.5", "highest": "5.5"}.items():
            assert said(tmp_path, code, name) == [value]


def test_what_was_compiled_from_earlier_versions_of_a_file_is_removed(tmp_path):
    file, other = tmp_path / "changing.py", tmp_path / "changing_not.py"
    other.write_text(KERNEL)
    said(tmp_path, "import changing_not; changing_not.twice(1.0)")
    for lines in range(3):  # whose names say where they begin
        file.write_text("# a line\n" * lines + KERNEL)
        said(tmp_path, "import changing; changing.twice(1.0); changing.twice(1)")
    names = {path.name.partition(".py")[0] for suffix in ("nbi", "nbc") for path in kept(tmp_path, suffix)}
    assert names == {"changing.twice-6", "changing_not.twice-4"}


@pytest.mark.parametrize("first", ["caller", "one"])
def test_what_others_take_up_is_an_entry_of_its_own_as_well(tmp_path, first):
    """Loaded in either order: the entry has constants, such as the type of an array, that its caller has not."""
    (tmp_path / "taken.py").write_text(
        "import numpy as np\nfrom comove.compiled import kernel\n\n"
        "@kernel\ndef one(x):\n    return np.full(2, x)\n\n"
        "@kernel\ndef caller(x):\n    return one(x)[1]\n"
    )
    code = (
        "import sys\nimport numpy as np\nimport taken\n"
        "for name in sys.argv[1:]: print(np.sum(getattr(taken, name)(3.0)))"
    )
    other = "one" if first == "caller" else "caller"
    for _ in range(2):
        assert said(tmp_path, code, first, other) == (["3.0", "6.0"] if first == "caller" else ["6.0", "3.0"])


@pytest.mark.parametrize(
    ("before", "after", "call", "values"),
    [
        ("a b", "b a", "first(Pair(a=np.ones(1), b=np.full(1, 2.0)))", ["1.0", "1.0"]),
        ("x - y", "y - x", "less(3.0)", ["1.0", "-1.0"]),
        ("return x", "return -x", "apply(same, 4.0)", ["4.0", "-4.0"]),
    ],
    ids=["fields", "parameters", "functions"],
)
def test_a_kernel_is_compiled_anew_when_what_it_is_given_has_changed(tmp_path, before, after, call, values):
    """Fields of a named tuple change places in another file, so do parameters, or a function that is an argument."""
    (tmp_path / "user.py").write_text(
        "import given\nfrom comove.compiled import kernel\n\n"
        "@kernel\ndef first(pair):\n    return pair.a[0]\n\n"
        "@kernel\ndef less(x):\n    return given.less(x=x, y=2.0)\n\n"
        "@kernel\ndef apply(f, x):\n    return f(x)\n"
    )
    text = (
        "from collections import namedtuple\nfrom comove.compiled import kernel\n\n"
        "Pair = namedtuple('Pair', 'a b')\n\n"
        "@kernel\ndef less(x, y):\n    return x - y\n\n"
        "@kernel\ndef same(x):\n    return x\n"
    )
    code = "import numpy as np\nfrom given import *\nfrom user import *\nprint(" + call + ")"
    if before == "x - y":
        code = code.replace("from given import *\n", "")
    found = []
    for new in (before, after):
        changed = text.replace("(x, y)", "(y, x)") if new == "y - x" else text
        (tmp_path / "given.py").write_text(changed.replace(before, new))
        found += said(tmp_path, code)
    assert found == values


def test_functions_of_numba_that_kernels_call_serve_python_as_well(tmp_path):
    """Before and after, in the process that compiles and in the next one."""
    (tmp_path / "mixed.py").write_text(
        "import numba\nfrom comove.compiled import kernel\n\n"
        "@numba.njit(cache=True)\ndef plain(x):\n    return 2.0 * x\n\n"
        "@kernel\ndef user(x):\n    return plain(x) + 1.0\n"
    )
    code = "from mixed import plain, user\nprint(user(1.5), plain(1.5))"
    for _ in range(2):
        assert said(tmp_path, code) == ["4.0", "3.0"]


def test_loops_over_arrays_are_vectorised(calling):
    add = calling(SUM).add
    values = np.arange(40.0).reshape(4, 10)
    add(values, values)
    (compiled,) = add.callee.overloads.values()
    assert " x double>" in str(compiled.library._final_module)
    np.testing.assert_array_equal(values, 2.0 * np.arange(40.0).reshape(4, 10))


def test_a_large_kernel_is_called_by_its_symbol_and_a_small_one_is_not_called_at_all(calling, monkeypatch):
    def called(large):
        monkeypatch.setattr(libraries, "LARGE", large)
        module = calling(CALLER.replace("below zero", f"below zero {large}"))
        module.outer(2.0)
        (compiled,) = module.outer.callee.overloads.values()
        names = [function.name for function in compiled.library._final_module.functions]
        return [any(part in name for name in names) for part in ("inner", "comove")]

    assert called(0) == [False, True]
    assert called(10**9) == [False, False]


@pytest.mark.parametrize("n", [0, 1, 2, 7, 64, 101])
def test_orders_are_sorted_stably(n):
    rng = np.random.default_rng(n)
    keys, order = rng.integers(0, 9, n + 4).astype(float), rng.permutation(n + 4)
    expected = order.copy()
    expected[2 : 2 + n] = expected[2 : 2 + n][np.argsort(keys[expected[2 : 2 + n]], kind="stable")]
    kernels.sort_by(keys, order, 2, 2 + n, np.empty_like(order))
    np.testing.assert_array_equal(order, expected)


def test_kernels_that_count_no_references_leave_them_as_they_were_and_allocate_none():
    @kernels.kernel(counted=False)
    def total(arrays):
        found = 0.0
        for row in range(arrays[0].shape[0]):
            one = arrays[0][row]
            found += one[0] + arrays[1][row]
        return found

    @kernels.kernel
    def twice(arrays):
        return total(arrays) + total((arrays[0], arrays[1].copy()))

    arrays = np.ones((4, 2)), np.ones(4)
    before = [sys.getrefcount(array) for array in arrays]
    assert twice(arrays) == 16.0
    assert [sys.getrefcount(array) for array in arrays] == before

    @kernels.kernel(counted=False)
    def made(n):
        return np.empty(n)[0]

    with pytest.raises(TypingError):
        made(3)


class Inner(NamedTuple):
    values: np.ndarray
    pair: tuple[np.ndarray, float]


class Outer(NamedTuple):
    rows: np.ndarray
    inner: Inner
    nothing: None
    flags: tuple[int, int]
    turned: complex


@kernels.kernel
def _with_all_parts(outer, k, out):
    rows, (values, pair), nothing, flags, turned = outer
    for i in range(out.shape[0]):  # which every part is needed for
        out[i] = rows[-1, i] + outer.inner.values[i] * pair[1] + flags[k] + turned.imag
        outer.inner.pair[0][i] = values[i] if nothing is None and flags[0] == 1 else 0.0
    return pair[0].copy()


def test_named_tuples_of_arrays_are_given_by_their_address():
    """Whatever their arrays look like, results are those of Python, and references stay as they were."""
    table = np.arange(24.0).reshape(4, 6)
    for rows in (table, table[:, ::2], np.asfortranarray(table), table[::-1]):
        outers = [
            Outer(rows, Inner(table[2].copy(), (np.zeros(6), 0.5)), None, (1, 7), 2 + 3j) for _ in range(2)
        ]
        outs = np.empty((2, rows.shape[1]))
        before = [sys.getrefcount(part) for part in (rows, outers[0].inner.values, outers[0].inner.pair[0])]
        kept = [
            function(outer, 1, out)
            for function, outer, out in zip(
                (_with_all_parts, _with_all_parts.py_func), outers, outs, strict=True
            )
        ]
        assert outs[0].tolist() == outs[1].tolist() and kept[0].tolist() == kept[1].tolist()
        after = [sys.getrefcount(part) for part in (rows, outers[0].inner.values, outers[0].inner.pair[0])]
        assert after == before
    signature = next(iter(_with_all_parts.callee.overloads))
    assert all(word not in str(signature[0]) for word in ("Array", "float64"))


def test_a_number_that_is_written_is_no_type_of_its_own():
    @kernels.kernel
    def next_to(k):
        return k + 1

    @kernels.kernel
    def both(k):
        return next_to(k) + next_to(2) + next_to(-1)

    assert both(4) == 8 and len(next_to.callee.overloads) == 1


def test_a_kernel_defined_in_a_function_is_compiled_as_well():
    @kernels.kernel
    def half(x):
        return x / 2

    @kernels.kernel
    def quarter(x):
        return half(half(x))

    assert quarter(2.0) == 0.5 and quarter(0.0) == 0.0


def test_division_by_zero_follows_the_rules_of_numpy():
    assert kernels.kernel(lambda x: 1.0 / x)(0.0) == np.inf


@pytest.mark.parametrize("turns", [1, 5])
@pytest.mark.slow
def test_two_processes_compile_into_one_empty_folder(tmp_path, turns):
    """Both compute the same, every time; the third process finds what they have left whole."""
    (tmp_path / "kernel.py").write_text(KERNEL)
    code = (
        "import sys, importlib.util, comove\n"
        "spec = importlib.util.spec_from_file_location('kernel_for_tests', sys.argv[1])\n"
        "module = sys.modules['kernel_for_tests'] = importlib.util.module_from_spec(spec)\n"
        "spec.loader.exec_module(module)\n"
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


@pytest.mark.slow
def test_of_two_processes_one_compiles_and_the_other_waits_and_loads(tmp_path):
    (tmp_path / "slow_for_tests.py").write_text(
        "from comove.compiled import kernel\n\n@kernel\ndef steps(x):\n"
        + "".join(f"    x = x * {k}.5 + abs(x - {k}.0)\n" for k in range(300))
        + "    return x\n"
    )
    code = (
        "import sys, slow_for_tests\nfrom comove.compiled.counting import compiling\nprint(flush=True)\n"
        "sys.stdin.readline()\nwith compiling() as compiled:\n    slow_for_tests.steps(1.0)\n"
        "print(sum(slow_for_tests.steps.callee.stats.cache_misses.values()))"
    )
    both = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            env={
                **os.environ,
                "NUMBA_CACHE_DIR": "",
                "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
            },
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    for process in both:
        process.stdout.readline()
    for process in both:
        process.stdin.write("\n")
        process.stdin.flush()
    assert sorted(process.communicate()[0].split() for process in both) == [["0"], ["1"]]


def test_a_process_that_is_stopped_while_it_compiles_holds_up_no_other(kernel, tmp_path, monkeypatch):
    monkeypatch.setattr(cache.KernelCache, "patience", 0.1)
    (tmp_path / "__pycache__").mkdir()
    code = (
        "import fcntl, sys\nfile = open(sys.argv[1], 'w')\nfcntl.lockf(file, fcntl.LOCK_EX)\n"
        "print(flush=True)\nsys.stdin.read()"
    )
    command = [sys.executable, "-c", code, tmp_path / "__pycache__" / "comove_kernels.lock"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        holder.stdout.readline()
        end = threading.Timer(10.0, holder.kill)
        end.start()
        assert kernel()(4) == 8
        assert holder.poll() is None
        end.cancel()
        holder.stdin.close()
    assert kernel()(4) == 8


def test_warnings_are_not_needed_for_what_works(kernel):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert kernel()(4) == 8


PARTS = {
    "values_for_tests": "FACTOR = 3.0\nTABLE = (1.0, 2.0)\n",
    "inner_for_tests": "from comove.compiled import kernel\n\n@kernel\ndef inner(x):\n    return x + 1.0\n",
    "world_for_tests": "from collections import namedtuple\n\nfrom comove.compiled import kernel\n"
    "from comove.planning.trees import length\n\nWorld = namedtuple('World', ['size'])\n\n"
    "@length.answered_for(World)\n@kernel\ndef size(world, p, q):\n"
    "    return world.size + p\n",
    "outer_for_tests": "from comove.compiled import kernel\nfrom comove.planning.trees import length\n"
    "from inner_for_tests import inner\nfrom values_for_tests import FACTOR, TABLE\n"
    "from world_for_tests import World\n\n@kernel\ndef outer(world, x):\n"
    "    return FACTOR * inner(x) + TABLE[1] + length(world, 0.5, 0.5)\n",
}
RUN = """
from outer_for_tests import World, outer
print(outer(World(4.0), 1.0), sum(outer.stats.cache_hits.values()))
"""


@pytest.fixture
def parts(tmp_path):
    """Write the modules of a kernel, and return a function that says in a new process what it computes."""
    for name, source in PARTS.items():
        (tmp_path / f"{name}.py").write_text(source)

    def computed():
        value, hits = said(tmp_path, RUN)
        return float(value), int(hits)

    return computed


CHANGES = (
    ("inner_for_tests", "x + 1.0", "x + 9.0", 36.5),  # the code of what is called
    ("values_for_tests", "FACTOR = 3.0", "FACTOR = 5.0", 56.5),  # a number
    ("values_for_tests", "2.0)", "8.0)", 62.5),  # a part of a tuple
    ("world_for_tests", "size + p", "size - p", 61.5),  # what answers a question about the world
)


def test_what_other_files_hold_is_never_out_of_date(parts, tmp_path):
    """One change after the other: a new one compiles, and what was compiled last is loaded."""
    assert parts() == (12.5, 0)
    assert parts() == (12.5, 1)
    for module, old, new, value in CHANGES:
        file = tmp_path / f"{module}.py"
        file.write_text(file.read_text().replace(old, new))
        assert parts() == (value, 0), module
    assert parts() == (61.5, 1)


@pytest.mark.slow
def test_a_comment_elsewhere_compiles_nothing_anew(parts, tmp_path):
    assert parts() == (12.5, 0)
    file = tmp_path / "inner_for_tests.py"
    file.write_text(file.read_text().replace("return", "# one more\n    return"))
    assert parts()[0] == 12.5
    assert parts() == (12.5, 1)


def test_a_fingerprint_tells_texts_and_not_docstrings():
    def made(text, docstring):
        space = {}
        exec(f"def named():\n    {docstring!r}\n    return (lambda: {text!r})()", space)
        return fingerprint(space["named"])

    assert made("one", "Say it.") == made("one", "Tell it.")
    assert made("one", "Say it.") != made("two", "Say it.")
