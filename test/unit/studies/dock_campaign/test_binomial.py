import pytest
from scipy import stats

from bullet_lab.studies.dock_campaign.results import BinomialError, lower_bound


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("trials", [1, 7, 200, 10_000])
def test_bound_is_the_quantile_of_the_beta_distribution(trials, confidence):
    for successes in sorted({1, trials // 2 + 1, trials - 1, trials} - {0}):
        expected = stats.beta.ppf(1.0 - confidence, successes, trials - successes + 1)
        assert lower_bound(successes, trials, confidence) == pytest.approx(expected, rel=1e-8)


def test_without_a_failure_it_is_the_closed_form():
    assert lower_bound(1000, 1000) == pytest.approx(0.05 ** (1 / 1000), rel=1e-12)
    # "0 failures in 1,000 starts bounds failure under 0.3 % at 95 %."
    assert 1.0 - lower_bound(1000, 1000) < 0.003


def test_without_a_success_nothing_is_promised():
    assert lower_bound(0, 10) == 0.0


def test_the_promise_is_kept():
    # Of all outcomes with p = 0.9, those whose bound is too high are no more than 5 %.
    p, trials = 0.9, 40
    broken = sum(
        stats.binom.pmf(k, trials, p) for k in range(trials + 1) if lower_bound(k, trials) > p
    )
    assert 0.0 < broken <= 0.05


@pytest.mark.parametrize("counts", [(0, 0), (-1, 3), (4, 3)])
def test_impossible_counts_are_refused(counts):
    with pytest.raises(BinomialError):
        lower_bound(*counts)


@pytest.mark.parametrize("confidence", [0.0, 1.0, float("nan")])
def test_impossible_confidence_is_refused(confidence):
    with pytest.raises(BinomialError):
        lower_bound(1, 2, confidence)
