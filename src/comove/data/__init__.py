"""Many runs: `solve_many`, generated episodes, sweeps, run databases and reports."""

from comove.data.generation import Study
from comove.data.many import Solved, solve_many
from comove.data.report import StudyReport, groups_of, report_of, write_report
from comove.data.runner import Shard, StudyProgress, on_processes, run_study
from comove.data.runs import StudyRun, StudyStore
from comove.data.sweep import StudyTable, Sweep, study

__all__ = [
    "Shard",
    "Solved",
    "Study",
    "StudyProgress",
    "StudyReport",
    "StudyRun",
    "StudyStore",
    "StudyTable",
    "Sweep",
    "groups_of",
    "on_processes",
    "report_of",
    "run_study",
    "solve_many",
    "study",
    "write_report",
]
