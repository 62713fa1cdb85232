"""Types of arrays, named after their content. The shape stands in the docstring of each function that uses an array."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
#: Truth values, one for each element.
Flags = NDArray[np.bool_]
#: Counts of an encoder after unwrapping.
Counts = NDArray[np.int64]
#: Indices into another array.
Places = NDArray[np.int64]
#: Real numbers of any integer or floating-point type.
Numbers = NDArray[np.integer | np.floating]
#: Limit of counts. Neighbouring integers beyond it share one double, so that a count would be silently wrong.
COUNT_LIMIT = 2**53
