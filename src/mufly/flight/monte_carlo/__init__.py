"""A thousand flights: what varies, who flies, how often it succeeds, and which flights are the worst."""

from mufly.flight.monte_carlo.campaign import Campaign, Case, Flown, fly_case, judged
from mufly.flight.monte_carlo.crew import Crew, case_of, run, search, severity, worst_first
from mufly.flight.monte_carlo.pictures import draw_distributions, draw_influences
from mufly.flight.monte_carlo.results import Measure, Outcome, Worst, measures, outcome_of, table_of, wilson
from mufly.flight.monte_carlo.variation import Variation, parse_variations

__all__ = [
    "Campaign",
    "Case",
    "Crew",
    "Flown",
    "Measure",
    "Outcome",
    "Variation",
    "Worst",
    "case_of",
    "draw_distributions",
    "draw_influences",
    "fly_case",
    "judged",
    "measures",
    "outcome_of",
    "parse_variations",
    "run",
    "search",
    "severity",
    "table_of",
    "wilson",
    "worst_first",
]
