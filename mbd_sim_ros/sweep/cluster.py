"""Cases on a running Dask cluster, which has this package installed on every worker."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mbd_sim_ros.sweep.case import Case, Row, row_of
from mbd_sim_ros.sweep.workers import TRIES, lost
from solver.errors import SpecError

SECONDS = 15.0  # to find the scheduler


def run_there(cases: Sequence[Case], address: str) -> Iterator[Row]:
    """The rows of the cases, as they are done. address: of the scheduler, e.g. tcp://10.0.0.1:8786. Raises SpecError."""
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise SpecError("--scheduler needs dask.distributed: pip install 'mbd_sim_ros[cluster]'") from None
    try:
        client = Client(address, timeout=SECONDS)
    except (OSError, ValueError, TypeError) as error:
        raise SpecError(f'--scheduler {address}: nobody answers there ({error}); start `dask scheduler` and give its address') from None
    with client:
        futures = {client.submit(row_of, case, retries=TRIES - 1, pure=False): case for case in cases}
        for future in as_completed(list(futures)):
            failed = future.exception()
            yield future.result() if failed is None else lost(futures[future], f'its worker died: {failed}')
