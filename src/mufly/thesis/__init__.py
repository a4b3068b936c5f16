"""Does it agree with the source? Tables and figures of the dissertation, ours beside theirs."""

from mufly.thesis.claims import CLAIMS, Claim, Verdict
from mufly.thesis.outcomes import Outcome, StudyName, run_study, studies

__all__ = ["CLAIMS", "Claim", "Outcome", "StudyName", "Verdict", "run_study", "studies"]
