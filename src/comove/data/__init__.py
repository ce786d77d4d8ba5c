"""Many runs: `solve_many`, generated episodes, sweeps, their store and their report."""

from comove.studies.generation import Study
from comove.studies.many import Solved, solve_many
from comove.studies.report import StudyReport, groups_of, report_of, write_report
from comove.studies.runner import Shard, StudyProgress, on_processes, run_study
from comove.studies.runs import StudyRun, StudyStore
from comove.studies.sweep import Sweep
from comove.studies.table import StudyTable, study

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
