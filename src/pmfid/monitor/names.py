"""Names of the detectors, for modules that must not import the classes yet (see `detectors.make_detectors`)."""

from __future__ import annotations

from typing import Literal, get_args

DetectorName = Literal["cusum", "page-hinkley", "glr", "chi-square"]
DETECTORS: tuple[DetectorName, ...] = get_args(DetectorName)
