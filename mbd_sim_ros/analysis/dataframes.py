"""Recordings as pandas DataFrames, xarray Datasets and Parquet files (extra `analysis`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from mbd_sim_ros.analysis import mapping, runs
from mbd_sim_ros.bags.reader import Run
from solver.errors import BagError, suggestion

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

TIME = 'time'  # name of the index [s]


@overload
def load(
    bag: str | Path, topics: Sequence[str] | None = None, *, to: Literal['pandas'] = 'pandas'
) -> dict[str, pd.DataFrame]: ...
@overload
def load(bag: str | Path, topics: Sequence[str] | None = None, *, to: Literal['xarray']) -> dict[str, xr.Dataset]: ...
def load(bag: str | Path, topics: Sequence[str] | None = None, *, to: str = 'pandas') -> dict[str, Any]:
    """Read a bag (or tables, see runs.read) into one DataFrame or Dataset per topic.

    topics: names as in the columns ('odom', 'tire/front_left/force'); all without any. The index of a DataFrame
    (to='pandas') is the time [s], a column is named like its channel ('odom/twist/wz'), `attrs['units']` tells its unit
    ('' where the recording does not), `attrs['metadata']` what the recording says about its run. The coordinate of a
    Dataset (to='xarray') is `time`, and every variable has its own `attrs['units']`. Raises BagError for a recording or
    topic that cannot be read, and where pandas or xarray is missing.
    """
    makers = {'pandas': frames, 'xarray': datasets}
    if to not in makers:
        raise BagError(f'load(..., to={to!r}): must be pandas or xarray')
    topics = [topics] if isinstance(topics, str) else topics
    run = runs.read(bag, [f'{topic.strip("/")}/*' for topic in topics] if topics is not None else ())
    run = mapping.in_si(run, runs.units(run))
    found = makers[to](run)
    if topics is None:
        return found
    wanted = [topic.strip('/') for topic in topics]
    for topic in wanted:
        if topic not in found:
            why = (
                f': {run.left_out[topic]}'
                if topic in run.left_out
                else suggestion(topic, run.known.keys() - run.left_out.keys())
            )
            raise BagError(f'{bag} has no topic {topic!r} that can be read{why}')
    return {topic: found[topic] for topic in wanted}


def frames(run: Run) -> dict[str, pd.DataFrame]:
    """The topics of a run as DataFrames, see load()."""
    try:
        import pandas as pd
    except ImportError:
        raise BagError("pandas is missing: pip install 'mbd_sim_ros[analysis]'") from None
    unit = runs.units(run)
    result = {}
    for topic, series in run.series.items():
        frame = pd.DataFrame(series.columns, index=pd.Index(series.time_ns * 1e-9, name=TIME), copy=False)
        frame.attrs = {'units': {name: unit(name) for name in series.columns}, 'metadata': dict(run.metadata)}
        result[topic] = frame
    return result


def datasets(run: Run) -> dict[str, xr.Dataset]:
    """The topics of a run as Datasets, see load()."""
    try:
        import xarray as xr
    except ImportError:
        raise BagError("xarray is missing: pip install 'mbd_sim_ros[analysis]'") from None
    unit = runs.units(run)
    result = {}
    for topic, series in run.series.items():
        variables = {name: (TIME, values, {'units': unit(name)}) for name, values in series.columns.items()}
        result[topic] = xr.Dataset(variables, {TIME: (TIME, series.time_ns * 1e-9, {'units': 's'})}, dict(run.metadata))
    return result


def export_parquet(run: Run, directory: Path) -> list[Path]:
    """Write one Parquet file per topic (slashes of its name as dots) and return them; pandas reads back what load()
    gives.

    Columns: time [s] (the index), `time_ns` [ns] as recorded, and the channels, whose fields carry their `unit`.
    Raises BagError when a file cannot be written and where pandas or pyarrow is missing.
    """
    try:
        import pandas as pd
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise BagError("pandas or pyarrow is missing: pip install 'mbd_sim_ros[analysis]'") from None
    files = []
    try:
        directory.mkdir(parents=True, exist_ok=True)
        names = runs.file_names(run.series)
        for topic, frame in frames(run).items():
            units = {**frame.attrs['units'], 'time_ns': 'ns', TIME: 's'}
            series = run.series[topic]
            whole = pd.DataFrame({'time_ns': series.time_ns, **series.columns}, index=frame.index, copy=False)
            whole.attrs = frame.attrs
            table = pa.Table.from_pandas(whole)
            fields = [part.with_metadata({'unit': units.get(part.name, '')}) for part in table.schema]
            file = directory / f'{names[topic]}.parquet'
            pq.write_table(table.cast(pa.schema(fields, table.schema.metadata)), file, compression='zstd')
            files.append(file)
    except OSError as error:
        raise BagError(f'cannot write to {directory}: {error.strerror or error}; choose another place') from None
    return files
