"""Does it agree with the source? Every figure and table of the dissertation, ours beside theirs."""

from mufly.thesis.catalogue import ITEMS, Item, item
from mufly.thesis.claims import CLAIMS, Claim, Verdict
from mufly.thesis.outcomes import Answer, Outcome, answer, cheap_first, recall, run_study, studies
from mufly.thesis.pages import report, table_page, totals

__all__ = [
    "CLAIMS",
    "ITEMS",
    "Answer",
    "Claim",
    "Item",
    "Outcome",
    "Verdict",
    "answer",
    "cheap_first",
    "item",
    "recall",
    "report",
    "run_study",
    "studies",
    "table_page",
    "totals",
]
