"""Comparison with the dissertation: each of its figures and tables, beside the results of this package."""

from mufly.thesis.claims import CLAIMS, Claim, Verdict
from mufly.thesis.comparison_pages import (
    count_outlook_states,
    count_verdicts,
    render_html_page,
    render_markdown_page,
    render_outlook_page,
)
from mufly.thesis.figure_catalogue import OUTLOOK_SENTENCES, THESIS_ITEMS, OutlookSentence, ThesisItem, find_item
from mufly.thesis.study_runner import (
    StudyAnswer,
    StudyOutcome,
    list_studies,
    list_studies_by_cost,
    load_cached_answer,
    load_or_run_study,
    run_study,
)

__all__ = [
    "CLAIMS",
    "OUTLOOK_SENTENCES",
    "THESIS_ITEMS",
    "Claim",
    "OutlookSentence",
    "StudyAnswer",
    "StudyOutcome",
    "ThesisItem",
    "Verdict",
    "count_outlook_states",
    "count_verdicts",
    "find_item",
    "list_studies",
    "list_studies_by_cost",
    "load_cached_answer",
    "load_or_run_study",
    "render_html_page",
    "render_markdown_page",
    "render_outlook_page",
    "run_study",
]
