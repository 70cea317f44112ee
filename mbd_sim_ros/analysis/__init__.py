"""Analysis of recordings: tables, data frames, comparison, pictures, reports."""

from __future__ import annotations

from mbd_sim_ros.analysis.dataframes import load

__all__ = ['load']
