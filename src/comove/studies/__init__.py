"""Many runs: `solve_many`, generated episodes, sweeps, their store and their report."""

from comove.studies.many import Solved, solve_many
from comove.studies.report import StudyReport, groups_of, report_of, write_report
from comove.studies.runner import Shard, StudyProgress, on_processes, run_study
from comove.studies.runs import StudyRun, StudyStore
from comove.studies.study import Study
from comove.studies.sweep import Sweep

__all__ = [
    "Shard",
    "Solved",
    "Study",
    "StudyProgress",
    "StudyReport",
    "StudyRun",
    "StudyStore",
    "Sweep",
    "groups_of",
    "on_processes",
    "report_of",
    "run_study",
    "solve_many",
    "write_report",
]
