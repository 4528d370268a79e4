"""Bags as tables and arrays for notebooks and other programs: CSV, Parquet, numpy."""

from swarmabs_bringup.export.arrays import export_arrays
from swarmabs_bringup.export.columns import TABLES, Column, TableFormat
from swarmabs_bringup.export.tables import export_tables

__all__ = ["TABLES", "Column", "TableFormat", "export_arrays", "export_tables"]
