"""What the tests of many jobs share: makers of jobs from files."""

from functools import partial

import pytest

from clothfit.fit.options import Request
from clothfit.many.job import Job, read_file


@pytest.fixture
def makers():
    """Makers of the jobs of scenes, one each, with options of a fit."""

    def made(paths, start=None, **options):
        chosen = Request(**options)
        return [partial(lambda path, number: Job(read_file(path), (), start, options=chosen), path) for path in paths]

    return made
