"""The report of a run: `report.html`, one self-contained page."""

from defplan_mj.report.report import write_report

__all__ = ["write_report"]
