//! Columns under effects: one linear-equivalent column for each situation, responses of every record at its bins.

use super::curves::Curves;
use super::fast_column::{FastColumn, Grid, March, element_count};
use super::neighbours::Neighbours;
use super::operators::Operators;
use super::problem::Problem;
use super::propagated::Propagated;
use super::settings::DiagnoseSettings;
use super::spectra::{self, Group};
use super::tuning::Tuning;
use super::unknowns::Placed;
use crate::column::Profile;
use crate::effects::{self, Effect, Operator, Situation};
use crate::error::Result;
use crate::records::Split;
use rayon::prelude::*;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Effective strain over the largest strain.
const EFFECTIVE: f64 = 0.7;
/// Most iterations of the strains of the declared column, the share of a step that each takes in ln, and the relative change
/// of every strain at which they end.
const GROUND: (usize, f64, f64) = (40, 0.5, 1e-4);
/// Iterations from there for columns with effects, and their share: a fixed number, so that costs are smooth.
const FROM_GROUND: (usize, f64) = (2, 0.8);
/// Strain with which an iteration starts.
const START_STRAIN: f64 = 1e-5;

/// The problem in the frequency domain.
#[derive(Clone)]
pub struct Scene<'a> {
    /// The problem.
    pub problem: &'a Problem,
    /// Events as spectra.
    pub groups: Vec<Group>,
    curves: Arc<Curves>,
    elements: usize,
    band_hz: [f64; 2],
    /// Effective strains of the declared column by group and record: where every iteration starts.
    ground: Arc<Vec<Vec<Vec<f64>>>>,
    /// By group and record.
    tuning: Arc<Vec<Vec<Tuning>>>,
    /// Replays around the declared soil; without them the fast column stands for its nuisances and velocities too.
    pub(super) neighbours: Option<Arc<Neighbours>>,
    /// Noise of the outputs beyond that of the sensors; empty without replays.
    pub(super) propagated: Arc<Propagated>,
    /// Weight of the priors of the nuisances.
    pub(super) stiffness: f64,
    is_dispersive: bool,
}

/// Responses of the columns of all records.
#[derive(Clone, Default)]
pub struct Responses {
    /// By group and record.
    pub records: Vec<Vec<Arc<RecordResponse>>>,
    /// What the effects do to the velocities that neighbours follow, prior standard deviations of each nuisance.
    shifts: Vec<Vec<Vec<f64>>>,
}

/// The state of the input sensor as seen at three frequencies, the channel that its motion is on, and what it adds by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputSensor {
    pub(super) source: usize,
    pub(super) probes: [Operator; 3],
    /// Σ of the magnitude of what it adds in the first record, m/s².
    pub(super) added: f64,
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
    /// The same at the convolver's frequencies.
    padded: Vec<C64>,
    /// What the input sensor made of it.
    pub seen_by: InputSensor,
    /// Motion of each output sensor's place under `input`, cut and tapered as the record is, `[bin][sensor]`.
    pub motion: Vec<C64>,
}

impl Responses {
    /// The soil of record `r` of group `g` at the unknowns `x`: deviations of its nuisances and effects that neighbours follow.
    pub(super) fn deviations(&self, [g, r]: [usize; 2], x: &Placed) -> Placed {
        let soil = self.shifts[g][r].iter().zip(&x.x).map(|(shift, x)| shift + x).collect();
        Placed { x: soil, axes: x.axes.clone() }
    }
}

impl<'a> Scene<'a> {
    /// Prepares `problem`.
    ///
    /// # Errors
    /// When an event is unusable.
    pub fn new(problem: &'a Problem, settings: &DiagnoseSettings) -> Result<Self> {
        let groups = spectra::groups(problem, settings)?;
        let high_hz = groups.iter().filter_map(|g| g.frequencies_hz.last()).fold(1.0f64, |m, f| m.max(*f));
        let tuning = groups.iter().map(|g| vec![Tuning::default(); g.records.len()]).collect();
        let mut scene = Self {
            problem,
            groups,
            curves: Arc::default(),
            elements: element_count(&problem.array.profile, high_hz),
            band_hz: [settings.band_hz[0], high_hz],
            ground: Arc::default(),
            tuning: Arc::new(tuning),
            neighbours: None,
            propagated: Arc::default(),
            stiffness: 1.0,
            is_dispersive: true,
        };
        scene.ground = Arc::new(scene.ground_strains()?);
        Ok(scene)
    }

    /// Prepares another problem of the same array and base motions, sharing curves, strains and tuning.
    ///
    /// # Errors
    /// When an event is unusable.
    pub fn sharing<'b>(&self, problem: &'b Problem, settings: &DiagnoseSettings) -> Result<Scene<'b>> {
        Ok(Scene {
            problem,
            groups: spectra::groups(problem, settings)?,
            curves: self.curves.clone(),
            ground: self.ground.clone(),
            tuning: self.tuning.clone(),
            neighbours: self.neighbours.clone(),
            propagated: self.propagated.clone(),
            ..*self
        })
    }

    /// The same scene with columns without dispersion ([`FastColumn::without_dispersion`]).
    #[must_use]
    pub fn without_dispersion(&self) -> Self {
        Self { is_dispersive: false, ..self.clone() }
    }

    /// Tunes the fast column of each record.
    pub(super) fn set_tuning(&mut self, tuning: Vec<Vec<Tuning>>) {
        self.tuning = Arc::new(tuning);
    }

    /// Strains of the column as declared, compatible with its moduli and damping.
    fn ground_strains(&self) -> Result<Vec<Vec<Vec<f64>>>> {
        let effects = effects::build_all(&self.problem.declared)?;
        let operators = Operators::new(self, &effects);
        let records: Vec<[usize; 2]> = self.record_indices().collect();
        let strains: Vec<Vec<f64>> = records
            .par_iter()
            .map(|&[g, r]| {
                let profile = self.profile(&effects, &self.problem.events[self.groups[g].records[r].event].situation);
                let column = FastColumn::new(&profile, self.elements, &self.curves)?;
                let grid = Grid::around(self.band_hz[0], self.band_hz[1], column.grid_step_hz());
                let input = self.true_input(&effects, &operators, g, r);
                let start = vec![START_STRAIN; column.n_element()];
                let (iterations, share, enough) = GROUND;
                let column = (&column, grid, Tuning::default());
                Ok(self.compatible([g, r], column, &input, start, (iterations, share, enough)))
            })
            .collect::<Result<_>>()?;
        let mut all = vec![Vec::new(); self.groups.len()];
        records.iter().zip(strains).for_each(|([g, _], strain)| all[*g].push(strain));
        Ok(all)
    }

    /// Group and index of every record.
    pub(super) fn record_indices(&self) -> impl Iterator<Item = [usize; 2]> {
        self.groups.iter().enumerate().flat_map(|(g, group)| (0..group.records.len()).map(move |r| [g, r]))
    }

    /// Strains after some iterations from `gamma`: γ ← γ (F(γ)/γ)^share, F the effective strains of the column with γ.
    fn compatible(
        &self,
        [g, r]: [usize; 2],
        (column, grid, tuning): (&FastColumn, Grid, Tuning),
        input: &[C64],
        mut gamma: Vec<f64>,
        (iterations, share, enough): (usize, f64, f64),
    ) -> Vec<f64> {
        let (group, record) = (&self.groups[g], &self.groups[g].records[r]);
        let bins = group.frequencies_hz.iter().zip(input);
        let displacement: Vec<C64> = bins.map(|(f, a)| a / -(TAU * f).powi(2)).collect();
        let to_effective = EFFECTIVE * record.peak_factor * 2.0f64.sqrt() / record.window.len() as f64;
        for _ in 0..iterations {
            let norm = column.march(grid, &gamma, &[], &tuning).strain_norm(&group.frequencies_hz, &displacement);
            let mut moved: f64 = 0.0;
            for (gamma, norm) in gamma.iter_mut().zip(norm) {
                let step = (to_effective * norm).max(1e-9) / *gamma;
                moved = moved.max((step - 1.0).abs());
                *gamma *= step.powf(share);
            }
            if moved < enough {
                break;
            }
        }
        gamma
    }

    /// Spectrum of a history as record `r` of group `g` is seen: its window, its taper, its bins.
    pub fn bins(&self, g: usize, r: usize, history: &[f64]) -> Vec<C64> {
        let window = &self.groups[g].records[r].window;
        self.windowed(g, history.get(window.clone()).unwrap_or_default())
    }

    /// Indices of the groups of `split`.
    pub fn of(&self, split: Split) -> Vec<usize> {
        (0..self.groups.len()).filter(|g| self.groups[*g].split == split).collect()
    }

    /// Number of whitened residuals of `groups`.
    pub fn n_residual(&self, groups: &[usize]) -> usize {
        groups.iter().map(|g| self.groups[*g].n_residual()).sum()
    }

    /// Responses under `effects` for `groups` (others are left empty). What is bit-identical to `near` is taken from there.
    ///
    /// # Errors
    /// When an edited column cannot be built.
    pub fn responses(
        &self,
        effects: &[Box<dyn Effect>],
        groups: &[usize],
        near: Option<&Responses>,
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
        let mut shifts: Vec<Vec<Vec<f64>>> = vec![Vec::new(); self.groups.len()];
        for &g in groups {
            for (r, record) in self.groups[g].records.iter().enumerate() {
                let (profile, shift) = self.edited(effects, &self.problem.events[record.event].situation);
                shifts[g].push(shift);
                let known = columns.iter().position(|(p, _)| **p == profile);
                let index = match known {
                    Some(index) => index,
                    None => {
                        let reused = near.and_then(|n| n.find(&profile));
                        let profile = reused.unwrap_or_else(|| Arc::new(profile));
                        let column = FastColumn::new(&profile, self.elements, &self.curves)?;
                        let column = if self.is_dispersive { column } else { column.without_dispersion() };
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
                let near = near.map(AsRef::as_ref);
                Arc::new(self.respond(
                    (effects, &operators),
                    [g, r],
                    &columns[index],
                    &depths_m,
                    (near, self.tuning[g][r]),
                ))
            })
            .collect();
        let mut records = vec![Vec::new(); self.groups.len()];
        for ((g, _, _), response) in which.iter().zip(computed) {
            records[*g].push(response);
        }
        Ok(Responses { records, shifts })
    }

    /// The fast column's profile.
    fn profile(&self, effects: &[Box<dyn Effect>], situation: &Situation) -> Profile {
        self.edited(effects, situation).0
    }

    fn respond(
        &self,
        (effects, operators): (&[Box<dyn Effect>], &Operators<'_>),
        [g, r]: [usize; 2],
        (profile, column): &(Arc<Profile>, Arc<FastColumn>),
        depths_m: &[f64],
        (near, tuning): (Option<&RecordResponse>, Tuning),
    ) -> RecordResponse {
        let group = &self.groups[g];
        let grid = Grid::around(self.band_hz[0], self.band_hz[1], column.grid_step_hz());
        let seen_by = self.input_sensor(effects, operators, g);
        let (input, padded) = match near.filter(|n| n.seen_by == seen_by) {
            Some(near) => (near.input.clone(), near.padded.clone()),
            None => (self.true_input(effects, operators, g, r), self.padded_input(effects, operators, g, r)),
        };
        let known = &self.ground[g][r];
        let at = |x: f64| known[((x * known.len() as f64) as usize).min(known.len() - 1)];
        let start =
            if known.len() == column.n_element() { known.clone() } else { column.relative_depths().map(at).collect() };
        let (iterations, share) = FROM_GROUND;
        let strain = self.compatible([g, r], (column, grid, tuning), &input, start, (iterations, share, 0.0));
        let march = column.march(grid, &strain, depths_m, &tuning);
        let mut transfer = vec![C64::default(); group.frequencies_hz.len() * depths_m.len()];
        for (f, out) in group.frequencies_hz.iter().zip(transfer.chunks_exact_mut(depths_m.len())) {
            march.response(*f, out);
        }
        let (first, count) = self.first_and_count(g);
        let bins = self.motion_bins(g, &march, &padded, depths_m.len());
        let cut = |bins: Vec<C64>| group.convolver.cut(bins.into_iter(), first, count);
        let motion = interleaved(bins.into_iter().map(cut).collect());
        RecordResponse {
            profile: profile.clone(),
            column: column.clone(),
            depths_m: depths_m.to_vec(),
            strain,
            transfer,
            input,
            padded,
            seen_by,
            motion,
        }
    }

    /// Motion at the output sensors of record `r` of group `g`, tuned otherwise: `[bin][sensor]`.
    pub(super) fn motion_with(
        &self,
        effects: &[Box<dyn Effect>],
        [g, r]: [usize; 2],
        tuning: Tuning,
    ) -> Result<Vec<C64>> {
        let array = &self.problem.array;
        let profile = self.profile(effects, &self.problem.events[self.groups[g].records[r].event].situation);
        let column = Arc::new(FastColumn::new(&profile, self.elements, &self.curves)?);
        let bottom_m = array.profile.depth_m();
        let sensors = array.outputs.iter().zip(&array.depths_m);
        let depths_m: Vec<f64> = sensors.map(|(name, z)| effects::depth_m(effects, name, *z, bottom_m)).collect();
        let operators = Operators::new(self, effects);
        let column = (Arc::new(profile), column);
        Ok(self.respond((effects, &operators), [g, r], &column, &depths_m, (None, tuning)).motion)
    }

    /// Motions of the output sensors' places under `input`, both at the convolver's frequencies.
    fn motion_bins(&self, g: usize, march: &March, input: &[C64], count: usize) -> Vec<Vec<C64>> {
        let mut bins = vec![vec![C64::default(); input.len()]; count];
        let mut at = vec![C64::default(); count];
        for (k, (f, input)) in self.groups[g].convolver.frequencies_hz.iter().zip(input).enumerate() {
            march.response(*f, &mut at);
            for (bins, at) in bins.iter_mut().zip(&at) {
                bins[k] = at * input;
            }
        }
        bins
    }

    /// Further arrivals at the output sensors in record `r` of group `g` under the true base motion that `response` has or that is
    /// `seen_by` another sensor, cut and tapered as the record is: what arrives late is beyond its end, not at its beginning.
    /// `[bin][sensor]`, empty where nothing arrives.
    pub(super) fn arrivals(
        &self,
        (effects, operators): (&[Box<dyn Effect>], &Operators<'_>),
        [g, r]: [usize; 2],
        (response, seen_by): (&RecordResponse, &InputSensor),
    ) -> Vec<C64> {
        if !operators.has_arrivals() {
            return Vec::new();
        }
        let convolver = &self.groups[g].convolver;
        let is_as_seen = response.seen_by == *seen_by;
        let moved = (!is_as_seen).then(|| self.padded_input(effects, operators, g, r));
        let input = moved.as_ref().unwrap_or(&response.padded);
        let (first, count) = self.first_and_count(g);
        let at = |depth_m: &f64| {
            let bins = convolver.frequencies_hz.iter().zip(input);
            convolver.cut(bins.map(|(f, input)| operators.arrival(*depth_m, *f) * input), first, count)
        };
        interleaved(self.problem.array.depths_m.iter().map(at).collect())
    }

    /// What tells one state of the input sensor from another in group `g`.
    pub(super) fn input_sensor(&self, effects: &[Box<dyn Effect>], operators: &Operators<'_>, g: usize) -> InputSensor {
        let frequencies_hz = &self.groups[g].frequencies_hz;
        let n = frequencies_hz.len();
        let probes = [0, n / 3, n - 1].map(|k| operators.at(0, frequencies_hz[k]));
        let source = self.source(effects, 0);
        let added = self.added(effects, [g, 0], source).map_or(0.0, |added| added.iter().map(|x| x.abs()).sum());
        InputSensor { source, probes, added }
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
        let march = response.column.march(grid, &response.strain, &response.depths_m, &self.tuning[g][r]);
        let input = self.padded_input(effects, &Operators::new(self, effects), g, r);
        let bins = self.motion_bins(g, &march, &input, response.depths_m.len());
        bins.into_iter().map(|bins| self.groups[g].convolver.history(bins.into_iter())).collect()
    }

    fn first_and_count(&self, g: usize) -> (usize, usize) {
        let frequencies_hz = &self.groups[g].frequencies_hz;
        let step_hz = frequencies_hz[1] - frequencies_hz[0];
        ((frequencies_hz[0] / step_hz).round() as usize, frequencies_hz.len())
    }

    /// Tapered spectrum of a history that has the window's length.
    pub(super) fn windowed(&self, g: usize, history: &[f64]) -> Vec<C64> {
        let (first, count) = self.first_and_count(g);
        self.groups[g].convolver.tapered(history, first, count)
    }
}

/// `[sensor][bin]` as `[bin][sensor]`.
fn interleaved(rows: Vec<Vec<C64>>) -> Vec<C64> {
    let n = rows.first().map_or(0, Vec::len);
    (0..n).flat_map(|k| rows.iter().map(move |row| row[k])).collect()
}

impl Responses {
    /// The profile equal to `profile` that these responses already share.
    fn find(&self, profile: &Profile) -> Option<Arc<Profile>> {
        self.records.iter().flatten().map(|r| &r.profile).find(|p| ***p == *profile).cloned()
    }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{DT_S, problem};
    use super::*;
    use crate::numerics::spectrum;

    #[test]
    fn what_arrives_after_the_end_is_not_at_the_beginning() {
        let (problem, settings) = (problem(""), DiagnoseSettings::default());
        let scene = Scene::new(&problem, &settings).unwrap();
        // The shaking has its middle at 14 of 41 s.
        for delay_s in [3.0, 27.0] {
            let table = format!("kind = 'surface_wave'\namplitude = 0.5\nvelocity_m_s = 200.0\ndelay_s = {delay_s:?}");
            let effects = effects::build_all(&[toml::from_str(&table).unwrap()]).unwrap();
            let operators = Operators::new(&scene, &effects);
            let responses = scene.responses(&effects, &[0], None).unwrap();
            let seen_by = scene.input_sensor(&effects, &operators, 0);
            let found = scene.arrivals((&effects, &operators), [0, 0], (&responses.records[0][0], &seen_by));
            for (s, depth_m) in problem.array.depths_m.iter().enumerate() {
                let input = &problem.events[0].input;
                let [late] = spectrum::respond([input], DT_S, |f, [u]| [u * operators.arrival(*depth_m, f)]);
                let expected = scene.windowed(0, &late[scene.groups[0].records[0].window.clone()]);
                let found = found.iter().skip(s).step_by(problem.array.depths_m.len());
                let error: f64 = found.zip(&expected).map(|(a, b)| (a - b).norm_sqr()).sum();
                let power: f64 = expected.iter().map(C64::norm_sqr).sum();
                assert!(error < 0.01 * power, "{delay_s} s, {depth_m} m: {error} of {power}");
            }
        }
    }
}
