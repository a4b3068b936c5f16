"""Monte Carlo campaigns of flights: parameter variations, workers, success rates and worst cases."""

from mufly.flight.monte_carlo.campaign import Campaign, FlightCase, FlightResult, compute_flight_result, fly_case
from mufly.flight.monte_carlo.campaign_files import RecordedFlights, record_notable_flights, write_campaign_results
from mufly.flight.monte_carlo.campaign_pictures import draw_distributions, draw_influences
from mufly.flight.monte_carlo.campaign_results import (
    CampaignOutcome,
    FlightMetric,
    MetricSummary,
    compute_wilson_interval,
    list_metrics,
    results_dataset,
    summarise_outcome,
)
from mufly.flight.monte_carlo.flight_ending import ENDINGS, FlightEnding
from mufly.flight.monte_carlo.variation import ParameterVariation, parse_variations
from mufly.flight.monte_carlo.worker_pool import (
    WorkerPool,
    campaign_to_dict,
    case_from_result,
    flight_severity,
    run_campaign,
    search_worst_case,
    sort_by_severity,
)

__all__ = [
    "ENDINGS",
    "Campaign",
    "CampaignOutcome",
    "FlightCase",
    "FlightEnding",
    "FlightMetric",
    "FlightResult",
    "MetricSummary",
    "ParameterVariation",
    "RecordedFlights",
    "WorkerPool",
    "campaign_to_dict",
    "case_from_result",
    "compute_flight_result",
    "compute_wilson_interval",
    "draw_distributions",
    "draw_influences",
    "flight_severity",
    "fly_case",
    "list_metrics",
    "parse_variations",
    "record_notable_flights",
    "results_dataset",
    "run_campaign",
    "search_worst_case",
    "sort_by_severity",
    "summarise_outcome",
    "write_campaign_results",
]
