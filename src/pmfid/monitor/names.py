"""Names of the detectors, for those who must not import them yet; `detectors.make_detectors` has the classes."""

from __future__ import annotations

from typing import Literal, get_args

DetectorName = Literal["cusum", "page-hinkley", "glr", "chi-square"]
DETECTORS: tuple[DetectorName, ...] = get_args(DetectorName)
