//! Probabilities of models, also where none of them is right.

use crate::inference::competition::Competition;
use crate::inference::forward::Forward;
use crate::inference::posterior::Fit;
use crate::numerics::random;
use rand::RngExt;

/// Draws of the events.
const DRAWS: usize = 1000;

/// A model as the records have it.
struct Standing {
    /// ln of its posterior up to a constant.
    log_posterior: f64,
    /// ln of the density of the records of each event up to constants, a part of that.
    by_event: Vec<f64>,
}

impl Standing {
    fn of(forward: &Forward<'_>, fit: &Fit<'_>, log_posterior: f64) -> Self {
        let mut by_event = vec![0.0; forward.groups.len()];
        for (at, rows) in forward.records.iter().zip(fit.rows.iter()) {
            by_event[at.group] -= rows.iter().map(|r| 0.5 * r * r).sum::<f64>();
        }
        Self { log_posterior, by_event }
    }
}

/// Posterior probability of each model of a `competition`; where a response without a name is ahead, none of them is the right one.
pub(super) fn probabilities(forward: &Forward<'_>, competition: &Competition<'_>) -> Vec<f64> {
    let of = |fit: &Fit<'_>| Standing::of(forward, fit, competition.log_posterior(fit));
    let standings: Vec<Standing> = competition.fits.iter().map(of).collect();
    if competition.best().model.is_named() { plain(&standings) } else { bagged(&standings) }
}

/// Posterior probability of each of `models`.
fn plain(models: &[Standing]) -> Vec<f64> {
    shares(models.iter().map(|m| m.log_posterior).collect())
}

/// The same, averaged over draws of the events with replacement.
///
/// ```text
/// p_m = ⟨ exp(L_m + Σ_e (n_e − 1) ℓ_me) / Σ_m' exp(L_m' + Σ_e (n_e − 1) ℓ_m'e) ⟩,   n_e how often event e was drawn       (1)
/// ```
///
/// Where none of the models is right, the posterior ends on one of those that do alike, whichever the events at hand favour by chance, and
/// is as sure of it as of a right one. How the events differ tells how much of that is chance.
///
/// Source: Huggins and Miller (2023), doi 10.1214/21-BA1301.
fn bagged(models: &[Standing]) -> Vec<f64> {
    let n_event = models.first().map_or(0, |m| m.by_event.len());
    let mut stream = random::stream(0, "draws of events");
    let mut sums = vec![0.0; models.len()];
    for _ in 0..DRAWS {
        let mut more = vec![-1.0; n_event];
        (0..n_event).for_each(|_| more[stream.random_range(0..n_event)] += 1.0);
        let drawn = |m: &Standing| m.log_posterior + m.by_event.iter().zip(&more).map(|(l, n)| l * n).sum::<f64>();
        let drawn = shares(models.iter().map(drawn).collect());
        sums.iter_mut().zip(drawn).for_each(|(sum, p)| *sum += p / DRAWS as f64);
    }
    sums
}

/// exp of each over the sum of all.
fn shares(ln: Vec<f64>) -> Vec<f64> {
    let highest = ln.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let each: Vec<f64> = ln.into_iter().map(|l| (l - highest).exp()).collect();
    let total: f64 = each.iter().sum();
    each.into_iter().map(|p| p / total).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    /// Two models of 12 events, the second ahead by `mean` in each on average, give or take 3.
    fn two(seed: u64, mean: f64) -> [Standing; 2] {
        let mut stream = random::stream(seed, "events");
        let normal = |_| -> f64 { StandardNormal.sample(&mut stream) };
        let ahead: Vec<f64> = (0..12).map(normal).map(|z| mean + 3.0 * z).collect();
        let of = |by_event: Vec<f64>| Standing { log_posterior: by_event.iter().sum(), by_event };
        [of(vec![0.0; 12]), of(ahead)]
    }

    #[test]
    fn of_two_that_are_wrong_alike_neither_is_sure() {
        let sure = |of: fn(&[Standing]) -> Vec<f64>| {
            (0..100).filter(|seed| of(&two(*seed, 0.0)).iter().any(|p| *p > 0.95)).count()
        };
        let [once, averaged] = [sure(plain), sure(bagged)];
        assert!(once > 70, "{once}");
        assert!(averaged < 20, "{averaged}");
        let ahead = (0..100).filter(|seed| bagged(&two(*seed, 4.0))[1] > 0.95).count();
        assert!(ahead > 90, "{ahead}");
    }

    #[test]
    fn what_all_events_favour_alike_is_as_sure_as_ever() {
        let of = |each: f64| Standing { log_posterior: 10.0 * each, by_event: vec![each; 10] };
        let models = [of(0.0), of(0.3)];
        let expected = 1.0 / (1.0 + (-3.0_f64).exp());
        assert!((bagged(&models)[1] - expected).abs() < 1e-12);
        assert!((plain(&models)[1] - expected).abs() < 1e-12);
        assert_eq!(bagged(&models), bagged(&models));
    }
}
