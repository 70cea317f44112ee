"""Cases on a running Dask cluster, which has this package installed on every worker."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from mbd_sim_ros.sweep.case import Row, SweepCase, row_of
from mbd_sim_ros.sweep.workers import TRIES, lost
from solver import stored
from solver.errors import SpecError

if TYPE_CHECKING:
    from distributed import WorkerPlugin

SECONDS = 15.0  # to find the scheduler


def run_there(cases: Sequence[SweepCase], address: str) -> Iterator[Row]:
    """The rows of the cases, as they are done. address: of the scheduler, e.g. tcp://10.0.0.1:8786. Raises
    SpecError."""
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise SpecError("--scheduler needs dask.distributed: pip install 'mbd_sim_ros[cluster]'") from None
    try:
        client = Client(address, timeout=SECONDS)
    except (OSError, ValueError, TypeError) as error:
        raise SpecError(
            f'--scheduler {address}: nobody answers there ({error}); start `dask scheduler` and give its address'
        ) from None
    with client:
        if arrays := stored.named_in('\n'.join({case.text for case in cases})):
            client.register_plugin(_with_arrays(arrays))
        futures = {client.submit(row_of, case, retries=TRIES - 1, pure=False): case for case in cases}
        for future in as_completed(list(futures)):
            failed = future.exception()
            yield future.result() if failed is None else lost(futures[future], f'its worker died: {failed}')


def _with_arrays(arrays: Mapping[str, bytes]) -> WorkerPlugin:
    """Gives the arrays that scenes name by their hash (roads of OpenCRG) to every worker there is, and to those that
    come later."""
    from distributed import WorkerPlugin

    class Arrays(WorkerPlugin):
        """Pickled by value, for it is made here."""

        name = 'mbd arrays'

        def setup(self, worker: object) -> None:
            """Before the worker takes its first case."""
            from solver import stored

            for digest, data in arrays.items():
                stored.accept(data, digest)

    return Arrays()
