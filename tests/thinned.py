"""Parameters of which the quick tests take a share, and the nightly tests all."""

import pytest
from _pytest.mark import ParameterSet


def parametrize(every, names, cases, **options):
    """Decorate a test as ``pytest.mark.parametrize`` does; all but each ``every``-th case is nightly."""
    several = not isinstance(names, str) or "," in names

    def given(case):
        if isinstance(case, ParameterSet):
            return case
        return pytest.param(*case) if several else pytest.param(case)

    def marked(number, case):
        marks = [*case.marks, pytest.mark.nightly] if number % every else case.marks
        return pytest.param(*case.values, marks=marks, id=case.id)

    return pytest.mark.parametrize(names, [marked(*one) for one in enumerate(map(given, cases))], **options)
