"""The formats of a record: a reader each, in a file of its own."""

#: Suffix -> name for people; for those who must not import a reader yet. `reading.READERS` has these.
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
#: "CSV, Parquet, ... or TDMS"
SPOKEN = " or ".join(", ".join(FORMATS.values()).rsplit(", ", 1))
