"""The processes that do a campaign's runs: Dask's, on this machine or a cluster."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import dask
from distributed import Client, LocalCluster

from cosim.errors import ExperimentError
from cosim.interrupts import interrupts_blocked

LOOPBACK = "127.0.0.1"
DASHBOARD = f"{LOOPBACK}:8787"  # it has no password: nobody but this machine may see it
CONNECT_TIMEOUT = 10.0  # [s] for a scheduler to answer
WORKERS_TIMEOUT = 30.0  # [s] for its first worker to appear


@contextmanager
def connected(scheduler: str | None, workers: int | None, dashboard: bool) -> Iterator[Client]:
    """A client of the scheduler, or of local worker processes that end with it.

    Raises:
        ExperimentError: the scheduler does not answer, or has no workers.
    """
    with ExitStack() as stack:
        if scheduler is None:
            # A worker holds one run at a time, so that an FMU that crashes takes no other run with it.
            settings: dict[str, object] = {"distributed.scheduler.worker-saturation": 1.0}
            if not dashboard:  # Dask opens its server all the same: it has no page then
                settings |= {f"distributed.{role}.http.routes": [] for role in ("scheduler", "worker")}
            stack.enter_context(dask.config.set(settings))
            with interrupts_blocked():
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    host=LOOPBACK,
                    dashboard_address=DASHBOARD if dashboard else f"{LOOPBACK}:0",
                    scheduler_kwargs={"dashboard": dashboard},
                    silence_logs=logging.CRITICAL,
                )
            yield stack.enter_context(Client(stack.enter_context(cluster)))
            return
        try:
            client = stack.enter_context(Client(scheduler, timeout=CONNECT_TIMEOUT))
            client.wait_for_workers(1, timeout=WORKERS_TIMEOUT)
        except (OSError, ValueError) as error:
            raise ExperimentError(f"no Dask workers behind the scheduler '{scheduler}': {error}") from None
        yield client
