"""Arrays by what they hold; the shape is in the docstring of what takes or gives them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
#: True or False of each element.
Flags = NDArray[np.bool_]
#: What an encoder's counter shows, unwrapped.
Counts = NDArray[np.int64]
#: Places in another array.
Places = NDArray[np.int64]
#: Real numbers in their own type.
Numbers = NDArray[np.integer | np.floating]
