"""Runs a study that needs no solver: python -m tests.data.driver FOLDER WORKERS TOTAL PAUSE LOG [to be killed]."""

import sys
from pathlib import Path

from comove.data import on_processes, run_study
from tests.data.works import FakeStudy

if __name__ == "__main__":
    folder, workers, total, pause, log = sys.argv[1:]
    study = FakeStudy(int(total), pause=float(pause), log=Path(log))
    run_study(study, folder, on_processes(int(workers)), tell=lambda p: print(p.done, flush=True))
