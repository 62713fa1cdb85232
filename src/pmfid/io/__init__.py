"""The formats of a record, each with a reader in its own file."""

#: Names of the formats by suffix, without the import of a reader. The table `reading.READERS` has the same suffixes.
FORMATS = {
    ".csv": "CSV",
    ".parquet": "Parquet",
    ".mat": "MATLAB .mat",
    ".npz": "NumPy",
    ".xlsx": "Excel",
    ".arrow": "Arrow",
    ".h5": "HDF5",
    ".wpilog": "WPILOG",
    ".mcap": "MCAP",
    ".db3": "rosbag2",
    ".mf4": "MDF4",
    ".tdms": "TDMS",
}
SUFFIXES = tuple(FORMATS)
#: The text "CSV, Parquet, ... or TDMS".
SPOKEN = " or ".join(", ".join(FORMATS.values()).rsplit(", ", 1))
