"""The history of a fleet on Apache Spark, at the place of the data. This package needs `pmfid[spark]` and a Java
runtime."""
