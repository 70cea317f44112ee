"""Sweeps: one scene run many times with other values, on the cores of this machine or on a cluster.

design.py reads the file and lays out the cases, case.py runs one, workers.py spreads them over processes (cluster.py
over a Dask cluster), table.py keeps what was found: a row a case, resumable, one Parquet table, sensitivities, a
report.
"""
