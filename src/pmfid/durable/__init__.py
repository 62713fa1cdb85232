"""Files that are either whole or absent on disk, also after a kill or a power failure."""
