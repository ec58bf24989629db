"""The namespace of an array's library, with the names of the array API standard."""

from __future__ import annotations

from typing import Any

import array_api_compat
import numpy as np

# From 2.1 on NumPy has the standard's names itself. Its compatible namespace imports all of NumPy's packages, such as
# f2py and testing, which no training needs.
_STANDARD = hasattr(np, "astype")


def array_namespace(array: Any) -> Any:  # noqa: ANN401 - an array of any library, and a module
    """Return the namespace of an array's library, with the names of the array API standard.

    Raises:
        TypeError: If it is no array.
    """
    if _STANDARD and isinstance(array, np.ndarray | np.generic):
        return np
    return array_api_compat.array_namespace(array)
