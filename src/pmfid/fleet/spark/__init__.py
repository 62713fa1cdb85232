"""The history of a fleet on Apache Spark, where the data already are; needs `pmfid[spark]` and a Java runtime."""
