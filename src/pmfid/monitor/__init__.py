"""Changes of a machine: block scores, detectors, calibrated thresholds, the cause of a change."""
