"""The formats of a record: a reader each, in a file of its own."""

#: Suffix -> name for people; for those who must not import a reader yet. `reading.READERS` has these.
FORMATS = {".csv": "CSV", ".parquet": "Parquet", ".mat": "MATLAB .mat"}
SUFFIXES = tuple(FORMATS)
#: "CSV, Parquet or MATLAB .mat"
SPOKEN = " or ".join(", ".join(FORMATS.values()).rsplit(", ", 1))
