"""Export of bags to CSV, Parquet and numpy, for notebooks and other programs."""

from swarmabs_analysis.export.arrays import export_arrays
from swarmabs_analysis.export.tables import TABLES, TableFormat, export_tables

__all__ = ["TABLES", "TableFormat", "export_arrays", "export_tables"]
