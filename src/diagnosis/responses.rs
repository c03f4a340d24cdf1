//! Columns under effects: one linear-equivalent column for each situation, responses of every record at its bins.

use super::anchor::Anchor;
use super::curves::Curves;
use super::fast_column::{FastColumn, Grid, March, element_count};
use super::operators::Operators;
use super::problem::Problem;
use super::settings::DiagnoseSettings;
use super::spectra::{self, Group};
use crate::column::Profile;
use crate::effects::{self, Effect, Situation};
use crate::error::Result;
use crate::records::Split;
use rayon::prelude::*;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Effective strain over the largest strain.
const EFFECTIVE: f64 = 0.7;
/// Error of an extrapolation as a share of what the fast column misses at its anchor.
const DISTRUST: f64 = 0.3;
/// Relative change of every strain at which an iteration ends.
const CONVERGED: f64 = 1e-4;
/// Strain with which an iteration starts.
const START_STRAIN: f64 = 1e-5;

/// The problem in the frequency domain.
pub struct Scene<'a> {
    /// The problem.
    pub problem: &'a Problem,
    /// Events as spectra.
    pub groups: Vec<Group>,
    curves: Arc<Curves>,
    elements: usize,
    band_hz: [f64; 2],
}

/// Responses of the columns of all records.
#[derive(Clone)]
pub struct Responses {
    /// By group and record.
    pub records: Vec<Vec<Arc<RecordResponse>>>,
}

/// Response of one record's column.
pub struct RecordResponse {
    profile: Arc<Profile>,
    column: Arc<FastColumn>,
    depths_m: Vec<f64>,
    /// Effective strains, surface down.
    pub strain: Vec<f64>,
    /// Motion of each output sensor's place over the base motion, `[bin][sensor]`.
    pub transfer: Vec<C64>,
    /// True base motion, by bin.
    pub input: Vec<C64>,
    /// Motion of each output sensor's place under `input`, cut and tapered as the record is, `[bin][sensor]`.
    pub motion: Vec<C64>,
}

impl<'a> Scene<'a> {
    /// Prepares `problem`.
    ///
    /// # Errors
    /// When an event is unusable.
    pub fn new(problem: &'a Problem, settings: &DiagnoseSettings) -> Result<Self> {
        Self::with(problem, settings, Arc::default())
    }

    /// Prepares another problem of the same array, sharing the curves measured so far.
    ///
    /// # Errors
    /// When an event is unusable.
    pub fn sharing<'b>(&self, problem: &'b Problem, settings: &DiagnoseSettings) -> Result<Scene<'b>> {
        Scene::with(problem, settings, self.curves.clone())
    }

    fn with(problem: &'a Problem, settings: &DiagnoseSettings, curves: Arc<Curves>) -> Result<Self> {
        let groups = spectra::groups(problem, settings)?;
        let high_hz = groups.iter().filter_map(|g| g.frequencies_hz.last()).fold(1.0f64, |m, f| m.max(*f));
        let elements = element_count(&problem.array.profile, high_hz);
        Ok(Self { problem, groups, curves, elements, band_hz: [settings.band_hz[0], high_hz] })
    }

    /// Spectrum of a history as record `r` of group `g` is seen: its window, its taper, its bins.
    pub fn bins(&self, g: usize, r: usize, history: &[f64]) -> Vec<C64> {
        let window = &self.groups[g].records[r].window;
        self.windowed(g, history.get(window.clone()).unwrap_or_default())
    }

    /// Counts what the fast column misses of the nonlinear one at `anchor` as an error of the motions, so that records which
    /// it cannot follow do not lead the search.
    pub fn distrust(&mut self, anchor: &Anchor) {
        for (group, anchors) in self.groups.iter_mut().zip(&anchor.records) {
            let step_hz = group.frequencies_hz[1] - group.frequencies_hz[0];
            let half = (spectra::SMOOTH_HZ / step_hz).round().max(1.0) as usize;
            for (record, anchor) in group.records.iter_mut().zip(anchors) {
                let Some(anchor) = anchor else { continue };
                let count = record.noise.len() - 1;
                for s in 0..count {
                    let rest: Vec<C64> = anchor.rest.iter().skip(s).step_by(count).copied().collect();
                    let power = spectra::smoothed(&rest, half);
                    record.distrust[s + 1] = power.iter().map(|p| DISTRUST * DISTRUST * p).collect();
                }
            }
        }
    }

    /// Indices of the groups of `split`.
    pub fn of(&self, split: Split) -> Vec<usize> {
        (0..self.groups.len()).filter(|g| self.groups[*g].split == split).collect()
    }

    /// Number of whitened residuals of `groups`.
    pub fn n_residual(&self, groups: &[usize]) -> usize {
        groups.iter().map(|g| self.groups[*g].n_residual()).sum()
    }

    /// Responses under `effects` for `groups` (others are left empty), strains iterated `iterations` times from those of
    /// `near`. What is bit-identical to `near` is taken from there.
    ///
    /// # Errors
    /// When an edited column cannot be built.
    pub fn responses(
        &self,
        effects: &[Box<dyn Effect>],
        groups: &[usize],
        near: Option<&Responses>,
        iterations: usize,
    ) -> Result<Responses> {
        let array = &self.problem.array;
        let depths_m: Vec<f64> = array
            .outputs
            .iter()
            .zip(&array.depths_m)
            .map(|(name, depth_m)| effects::depth_m(effects, name, *depth_m, array.profile.depth_m()))
            .collect();
        let mut columns: Vec<(Arc<Profile>, Arc<FastColumn>)> = Vec::new();
        let mut which: Vec<(usize, usize, usize)> = Vec::new();
        for &g in groups {
            for (r, record) in self.groups[g].records.iter().enumerate() {
                let profile = self.profile(effects, &self.problem.events[record.event].situation);
                let known = columns.iter().position(|(p, _)| **p == profile);
                let index = match known {
                    Some(index) => index,
                    None => {
                        let reused = near.and_then(|n| n.find(&profile));
                        let profile = reused.unwrap_or_else(|| Arc::new(profile));
                        let column = FastColumn::new(&profile, self.elements, &self.curves)?;
                        columns.push((profile, Arc::new(column)));
                        columns.len() - 1
                    }
                };
                which.push((g, r, index));
            }
        }
        let operators = Operators::new(self, effects);
        let computed: Vec<Arc<RecordResponse>> = which
            .par_iter()
            .map(|&(g, r, index)| {
                let near = near.and_then(|n| n.records[g].get(r));
                if let Some(near) = near
                    && Arc::ptr_eq(&near.profile, &columns[index].0)
                    && near.depths_m == depths_m
                {
                    return near.clone();
                }
                let strain = near.map(|n| n.strain.as_slice());
                Arc::new(self.respond((effects, &operators), [g, r], &columns[index], &depths_m, (strain, iterations)))
            })
            .collect();
        let mut records = vec![Vec::new(); self.groups.len()];
        for ((g, _, _), response) in which.iter().zip(computed) {
            records[*g].push(response);
        }
        Ok(Responses { records })
    }

    fn profile(&self, effects: &[Box<dyn Effect>], situation: &Situation) -> Profile {
        let mut profile = self.problem.array.profile.clone();
        for effect in effects {
            effect.edit(&mut profile, situation);
        }
        profile
    }

    fn respond(
        &self,
        (effects, operators): (&[Box<dyn Effect>], &Operators<'_>),
        [g, r]: [usize; 2],
        (profile, column): &(Arc<Profile>, Arc<FastColumn>),
        depths_m: &[f64],
        (strain, iterations): (Option<&[f64]>, usize),
    ) -> RecordResponse {
        let group = &self.groups[g];
        let record = &group.records[r];
        let grid = Grid::around(self.band_hz[0], self.band_hz[1], column.grid_step_hz());
        let input = self.true_input(effects, operators, g, r);
        let displacement: Vec<C64> =
            group.frequencies_hz.iter().zip(&input).map(|(f, a)| a / -(TAU * f).powi(2)).collect();
        let n = record.window.len() as f64;
        let to_effective = EFFECTIVE * record.peak_factor * 2.0f64.sqrt() / n;
        let mut gamma = match strain {
            Some(known) if known.len() == column.n_element() => known.to_vec(),
            Some(known) => column
                .relative_depths()
                .map(|x| known[((x * known.len() as f64) as usize).min(known.len() - 1)])
                .collect(),
            None => vec![START_STRAIN; column.n_element()],
        };
        let mut march = column.march(grid, &gamma, depths_m);
        for _ in 0..iterations {
            let norm = march.strain_norm(&group.frequencies_hz, &displacement);
            let mut moved: f64 = 0.0;
            for (gamma, norm) in gamma.iter_mut().zip(norm) {
                let next = (to_effective * norm).max(1e-9);
                moved = moved.max((next / *gamma - 1.0).abs());
                *gamma = next;
            }
            march = column.march(grid, &gamma, depths_m);
            if moved < CONVERGED {
                break;
            }
        }
        let mut transfer = vec![C64::default(); group.frequencies_hz.len() * depths_m.len()];
        for (f, out) in group.frequencies_hz.iter().zip(transfer.chunks_exact_mut(depths_m.len())) {
            march.response(*f, out);
        }
        let padded = self.padded_input(effects, operators, g, r);
        let histories = self.histories(g, &march, &padded, depths_m.len());
        let motion = interleaved(histories.iter().map(|h| self.windowed(g, h)).collect());
        RecordResponse {
            profile: profile.clone(),
            column: column.clone(),
            depths_m: depths_m.to_vec(),
            strain: gamma,
            transfer,
            input,
            motion,
        }
    }

    /// Motions of the output sensors' places under `input` (at the convolver's frequencies) as histories of the record's window.
    fn histories(&self, g: usize, march: &March, input: &[C64], count: usize) -> Vec<Vec<f64>> {
        let convolver = &self.groups[g].convolver;
        let mut bins = vec![vec![C64::default(); input.len()]; count];
        let mut at = vec![C64::default(); count];
        for (k, (f, input)) in convolver.frequencies_hz.iter().zip(input).enumerate() {
            march.response(*f, &mut at);
            for (bins, at) in bins.iter_mut().zip(&at) {
                bins[k] = at * input;
            }
        }
        bins.into_iter().map(|bins| convolver.history(bins.into_iter())).collect()
    }

    /// Motions of the output sensors' places of record `r` of group `g`, not tapered.
    pub(super) fn motions(
        &self,
        effects: &[Box<dyn Effect>],
        [g, r]: [usize; 2],
        responses: &Responses,
    ) -> Vec<Vec<f64>> {
        let response = &responses.records[g][r];
        let grid = Grid::around(self.band_hz[0], self.band_hz[1], response.column.grid_step_hz());
        let march = response.column.march(grid, &response.strain, &response.depths_m);
        let input = self.padded_input(effects, &Operators::new(self, effects), g, r);
        self.histories(g, &march, &input, response.depths_m.len())
    }

    /// Tapered spectrum of a history that has the window's length.
    pub(super) fn windowed(&self, g: usize, history: &[f64]) -> Vec<C64> {
        let group = &self.groups[g];
        let step_hz = group.frequencies_hz[1] - group.frequencies_hz[0];
        let first = (group.frequencies_hz[0] / step_hz).round() as usize;
        group.convolver.tapered(history, first, group.frequencies_hz.len())
    }
}

/// `[sensor][bin]` as `[bin][sensor]`.
fn interleaved(rows: Vec<Vec<C64>>) -> Vec<C64> {
    let n = rows.first().map_or(0, Vec::len);
    (0..n).flat_map(|k| rows.iter().map(move |row| row[k])).collect()
}

impl Responses {
    /// Nothing but the strains, as a start for the same columns once more.
    pub fn strains_only(&self) -> Self {
        let bare = |r: &Arc<RecordResponse>| {
            Arc::new(RecordResponse {
                profile: r.profile.clone(),
                column: r.column.clone(),
                depths_m: Vec::new(),
                strain: r.strain.clone(),
                transfer: Vec::new(),
                input: Vec::new(),
                motion: Vec::new(),
            })
        };
        Self { records: self.records.iter().map(|group| group.iter().map(bare).collect()).collect() }
    }

    /// Whether every column is the very one of `other`.
    pub fn shares_columns(&self, other: &Self) -> bool {
        let pairs = self.records.iter().flatten().zip(other.records.iter().flatten());
        pairs.into_iter().all(|(a, b)| Arc::ptr_eq(a, b))
    }

    /// The profile equal to `profile` that these responses already share.
    fn find(&self, profile: &Profile) -> Option<Arc<Profile>> {
        self.records.iter().flatten().map(|r| &r.profile).find(|p| ***p == *profile).cloned()
    }
}
