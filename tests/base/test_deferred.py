"""Modules that are put off load when they are used, and behave as ever."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow  # starts processes


def answer(code):
    """What a process of its own prints."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()


def test_what_is_put_off_loads_when_it_is_used_and_not_before():
    code = (
        "import sys\nfrom clothfit.base.deferred import defer\ndefer()\nimport numba, scipy.linalg, scipy.sparse\n"
        "print(any(name in sys.modules for name in ('numpy.f2py.crackfortran', 'unittest', 'yaml.reader')))\n"
        "import numpy as np\nnp.testing.assert_equal(1, 1)\nprint('unittest' in sys.modules)\n"
        "from numpy import f2py\nprint(f2py.get_include() != '', np.ma.masked_array([1, 2], [0, 1]).sum())\n"
        "from importlib import metadata\nprint(metadata.version('numpy') == np.__version__)\n"
    )
    assert answer(code) == ["False", "True", "True", "1", "True"]


def test_of_a_package_that_is_put_off_a_module_loads_alone_and_the_rest_when_it_is_used_and_what_is_loaded_stays():
    code = (
        "import sys\nimport numpy.ma as a\nfrom clothfit.base.deferred import LINEAR_ALGEBRA, defer\n"
        "defer((*LINEAR_ALGEBRA, 'numpy.ma'))\nimport numpy.ma as b\nprint(a is b)\n"
        "from scipy.linalg import blas, lapack\nprint('scipy.linalg._basic' in sys.modules)\n"
        "import scipy.linalg\nprint(scipy.linalg.lapack is lapack, hasattr(scipy.linalg, '_clapack'))\n"
        "import scipy.optimize, scipy.sparse.linalg\nprint(scipy.linalg.det([[3.0]]), 'det' in dir(scipy.linalg))\n"
    )
    assert answer(code) == ["True", "False", "True", "False", "3.0", "True"]
