"""A cluster whose connections are encrypted and known by a certificate, as docs/safety.md says how
to set it up.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from pixsim import PixsimError
from pixsim.studies.engine import results_of, workers_for

# as in docs/safety.md
MAKE = "req -x509 -newkey rsa:2048 -nodes -days 1 -subj /CN=pixsim -keyout key.pem -out cert.pem"


def double(task: int, _: None) -> int:
    return 2 * task


@pytest.mark.skipif(
    shutil.which("openssl") is None, reason="no openssl, which makes the certificate"
)
def test_a_study_talks_to_its_cluster_by_tls_alone(tmp_path: Path) -> None:
    distributed = pytest.importorskip(
        "distributed", reason="Dask is not installed (pip install 'pixsim[cluster]')"
    )
    import dask

    subprocess.run(["openssl", *MAKE.split()], cwd=tmp_path, check=True, capture_output=True)
    settings = {"require-encryption": True, "tls.ca-file": str(tmp_path / "cert.pem")}
    for end in ("client", "scheduler", "worker"):
        settings |= {f"tls.{end}.{name}": str(tmp_path / f"{name}.pem") for name in ("cert", "key")}
    with (
        dask.config.set({f"distributed.comm.{name}": value for name, value in settings.items()}),
        distributed.LocalCluster(
            n_workers=1,
            processes=False,
            dashboard_address=None,
            host="tls://127.0.0.1",
            security=distributed.Security(),
        ) as cluster,
    ):
        address = cluster.scheduler_address
        calls = [(task, lambda: None) for task in (1, 2, 3)]
        with workers_for(scheduler=address) as workers:
            assert sorted(results_of(double, calls, workers)) == [2, 4, 6]
        plain = address.replace("tls", "tcp")
        with pytest.raises(PixsimError, match="--scheduler"), workers_for(scheduler=plain):
            pass
