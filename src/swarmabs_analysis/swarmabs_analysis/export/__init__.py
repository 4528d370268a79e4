"""Export of bags to CSV, Parquet, numpy and MATLAB, for notebooks and other programs."""

from swarmabs_analysis.export.arrays import SUFFIXES, ArrayFormat, export_arrays
from swarmabs_analysis.export.tables import TABLES, TableFormat, export_tables

__all__ = ["SUFFIXES", "TABLES", "ArrayFormat", "TableFormat", "export_arrays", "export_tables"]
