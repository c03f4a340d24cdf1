//! The three learned stages on a small synthetic column: accuracy, bounds, resumption, files.

#[path = "support/python.rs"]
mod python_with;
#[path = "support/synthetic_column.rs"]
mod synthetic_column;

use flare_pipe::flare::{
    CalibrateSettings, Calibration, Case, Data, DistillSettings, Event, Normalisation, Observation, PretrainSettings,
    Solver, SourceModel, SparseEncoder, Training, calibrate, distill, predict, pretrain, reconstruct,
};
use flare_pipe::numerics::spill::{Spill, Values};
use flare_pipe::progress::{Progress, Quiet};
use python_with::python;
use std::panic::AssertUnwindSafe;
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use synthetic_column::Synthetic;

const N_TRAIN: usize = 12;

fn column() -> Synthetic {
    Synthetic { n_case: 16, duration_s: 8.0, channels: 12, sensor_depth_m: vec![11.0, 0.0], ..Default::default() }
}

fn settings() -> PretrainSettings {
    PretrainSettings {
        latent: 8,
        channels: 12,
        segments: 3,
        final_segments: 2,
        encoder_hidden: vec![24],
        decoder_hidden: vec![24],
        epochs: 60,
        batch: 16,
        learning_rate: 3e-3,
        threshold_every: 15,
        validate_every: 5,
        checkpoint_every: 5,
        stress_factor: 2.0,
        ..Default::default()
    }
}

struct Trained {
    cases: Vec<Case>,
    observation: Observation,
    model: SourceModel,
    encoder: SparseEncoder,
}

fn trained() -> &'static Trained {
    static TRAINED: OnceLock<Trained> = OnceLock::new();
    TRAINED.get_or_init(|| {
        let (cases, observation) = column().cases(N_TRAIN);
        let (train, validation) = cases.split_at(N_TRAIN);
        let (model, _) = pretrain(train, validation, &settings(), 1, &Training::in_memory(&Quiet)).expect("pretrains");
        let distill_settings =
            DistillSettings { window: 5, hidden: vec![32], epochs: 60, batch: 64, ..Default::default() };
        let (encoder, _) =
            distill(&model, train, validation, &distill_settings, 1, &Training::in_memory(&Quiet)).expect("distils");
        Trained { cases, observation, model, encoder }
    })
}

/// Root-mean-square error over the root mean square of the target (%).
fn error_percent(found: &[f32], target: &[f32]) -> f64 {
    let error: f64 = found.iter().zip(target).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    let power: f64 = target.iter().map(|b| f64::from(*b).powi(2)).sum();
    assert_eq!(found.len(), target.len());
    100.0 * (error / power).sqrt()
}

#[test]
fn whole_motions_never_seen_are_rolled_out_from_one_window() {
    let t = trained();
    for case in &t.cases[N_TRAIN..] {
        let response = t.model.roll_out(case).expect("bounded");
        let error = error_percent(&response, &case.dense[2 * 12..]);
        assert!(error < 35.0, "case {}: {error} %", case.id);
    }
}

#[test]
fn the_sparse_encoder_reads_the_state_from_two_sensors() {
    let t = trained();
    for case in &t.cases[N_TRAIN..] {
        let response = reconstruct(&t.model, &t.encoder, &t.observation, &case.sparse);
        let error = error_percent(&response, &case.sparse[4 * 2..]);
        assert!(error < 20.0, "case {}: {error} %", case.id);
    }
}

#[test]
fn records_of_another_column_are_predicted_better_after_calibration() {
    let t = trained();
    let other = Synthetic { velocity_factor: 0.95, n_case: 9, seed: 9, ..column() };
    let events: Vec<Event> = other
        .cases_like(&t.observation, column().input_std(N_TRAIN))
        .into_iter()
        .map(|c| Event { id: c.id, u: c.u.to_vec(), u_half: c.u_half.to_vec(), sparse: c.sparse.to_vec() })
        .collect();
    let settings = CalibrateSettings::default();
    let data = Data { simulations: &t.cases[..N_TRAIN], train: &events[..5], validation: &events[5..7] };
    let calibration =
        calibrate(&t.model, &t.encoder, &t.observation, &data, &settings, None, &Quiet).expect("calibrates");
    let test_error = |xi: &[f32]| -> f64 {
        let one = |e: &Event| {
            let window = &e.sparse[..5 * 2];
            let response = predict(&t.model, &t.encoder, xi, &t.observation, window, &e.u, &e.u_half).expect("bounded");
            error_percent(&response, &e.sparse[4 * 2..])
        };
        events[7..].iter().map(one).sum::<f64>() / 2.0
    };
    let (before, after) = (test_error(t.model.coefficients()), test_error(&calibration.coefficients));
    assert!(after < 0.8 * before, "{after} % after, {before} % before");
    assert!(calibration.cosine_similarity > 0.9, "{}", calibration.cosine_similarity);
    for (kept, was_kept) in calibration.mask.iter().zip(&t.model.mask) {
        assert!(*was_kept || !*kept, "a term came back");
    }

    let dir = tempfile::tempdir().expect("folder");
    calibration.save(dir.path(), &t.model.shape).expect("saves");
    let back = Calibration::load(dir.path(), &t.model.shape).expect("loads");
    assert_eq!(back.coefficients, calibration.coefficients);
    assert_eq!(back.mask, calibration.mask);
    assert!(dir.path().join("history.csv").is_file());
}

#[test]
fn validation_motions_twice_as_strong_and_ten_times_as_long_stay_bounded() {
    let t = trained();
    let mut model = t.model.clone(); // as the stage saves and judges it
    model.limit_softly(&t.cases[..N_TRAIN], settings().limit_factor);
    for case in &t.cases[N_TRAIN..] {
        let strong = |x: &[f32]| x.iter().map(|v| 2.0 * v).collect();
        let doubled =
            Case { u: strong(&case.u), u_half: strong(&case.u_half), dense: strong(&case.dense), ..case.clone() };
        assert!(model.roll_out(&doubled).expect("bounded").iter().all(|v| v.abs() < 1e3));
        let mut u_half = [&case.u_half[..], &[0.0]].concat().repeat(10);
        u_half.pop();
        let long = Case {
            u: case.u.repeat(10).into(),
            u_half: u_half.into(),
            dense: case.dense.repeat(10).into(),
            ..case.clone()
        };
        assert!(model.roll_out(&long).expect("bounded").iter().all(|v| v.abs() < 1e3));
    }
}

#[test]
fn soft_limits_keep_every_finite_motion_bounded_and_leave_trained_ones_alone() {
    let t = trained();
    let mut limited = t.model.clone();
    limited.limit_softly(&t.cases[..N_TRAIN], 1.5);
    for case in &t.cases[..N_TRAIN] {
        assert_eq!(limited.roll_out(case).expect("bounded"), t.model.roll_out(case).expect("bounded"));
    }
    let dir = tempfile::tempdir().expect("folder");
    let normalisation =
        Normalisation { input_std_m_s2: 1.0, channel_depth_m: vec![0.0; 12], dense_std_m_s2: vec![1.0; 12] };
    limited.save(dir.path(), &normalisation).expect("saves");
    assert!(SourceModel::load(dir.path()).expect("loads").0 == limited, "limits are part of the checkpoint");
    // equations that blow up as soon as they are left to themselves
    let mut wild = limited.clone();
    wild.parameters[..limited.mask.len()].iter_mut().for_each(|c| *c *= 25.0);
    for model in [&limited, &wild] {
        for case in &t.cases[N_TRAIN..] {
            assert!(model.guard_doubled(case).is_finite && model.guard_tenfold(case).is_finite);
            for factor in [1e2_f32, 1e9, 1e30] {
                let huge = |x: &[f32]| x.iter().map(|v| v * factor).collect();
                let case =
                    Case { u: huge(&case.u), u_half: huge(&case.u_half), dense: huge(&case.dense), ..case.clone() };
                assert!(model.roll_out(&case).expect("bounded").iter().all(|v| v.is_finite()), "factor {factor}");
            }
        }
    }
    let wild = SourceModel { shape: t.model.shape.clone(), ..wild };
    assert!(t.cases[N_TRAIN..].iter().all(|case| wild.roll_out(case).is_err()), "without limits it diverges");
}

#[test]
fn trainings_with_next_to_no_memory_end_in_the_same_bytes() {
    let (cases, _) = Synthetic { n_case: 6, duration_s: 4.0, ..column() }.cases(4);
    let settings = PretrainSettings { epochs: 6, polish_every: 3, polish_steps: 2, ..settings() };
    let distilled = DistillSettings { window: 5, epochs: 5, ..Default::default() };
    let dir = tempfile::tempdir().expect("folder");
    let outcome = |training: &Training<'_>, keeps: bool| {
        let keep = |x: &[f32]| if keeps { training.spill.keep(x.to_vec()).expect("kept") } else { x.to_vec().into() };
        let case = |c: &Case| Case {
            id: c.id.clone(),
            u: keep(&c.u),
            u_half: keep(&c.u_half),
            dense: keep(&c.dense),
            sparse: keep(&c.sparse),
        };
        let cases: Vec<Case> = cases.iter().map(case).collect();
        let is_mapped = |c: &Case| matches!(c.dense, Values::Mapped { .. });
        assert_eq!(cases.iter().any(is_mapped), keeps);
        let (train, validation) = cases.split_at(4);
        let (model, history) = pretrain(train, validation, &settings, 5, training).expect("trains");
        let (encoder, more) = distill(&model, train, validation, &distilled, 5, training).expect("distils");
        (model, history.to_csv(), encoder, more.to_csv())
    };
    let whole = outcome(&Training::in_memory(&Quiet), false);
    let spill = Spill::new(5_000, dir.path());
    assert!(outcome(&Training { spill, ..Training::in_memory(&Quiet) }, true) == whole);
    assert_eq!(std::fs::read_dir(dir.path()).expect("a folder").count(), 0);
}

#[test]
fn training_taken_up_from_its_checkpoint_ends_in_the_same_bytes() {
    let (cases, _) = Synthetic { n_case: 6, duration_s: 4.0, ..column() }.cases(4);
    let (train, validation) = cases.split_at(4);
    let settings =
        PretrainSettings { epochs: 13, validate_every: 2, checkpoint_every: 4, threshold_every: 3, ..settings() };
    let whole = pretrain(train, validation, &settings, 5, &Training::in_memory(&Quiet)).expect("trains");
    let dir = tempfile::tempdir().expect("folder");
    // leaves the state after epoch 8 behind, as a killed training does
    let kept = Training { checkpoint_dir: Some(dir.path()), ..Training::in_memory(&Quiet) };
    pretrain(train, validation, &settings, 5, &kept).expect("trains");
    let resumed = pretrain(train, validation, &settings, 5, &kept).expect("goes on");
    assert!(whole.0 == resumed.0, "models differ");
    assert_eq!(whole.1.to_csv(), resumed.1.to_csv());
    // another seed is another training and does not take the state up
    let other = pretrain(train, validation, &settings, 6, &kept).expect("trains");
    assert!(other.0 != whole.0);
}

/// Ends the training it listens to after some steps, as a kill does.
struct Killer {
    left: AtomicU64,
}

impl Progress for Killer {
    fn start(&self, _: &str, _: u64) {}
    fn advance(&self, steps: u64) {
        let left = self.left.load(Ordering::SeqCst);
        assert!(left > steps, "killed");
        self.left.store(left - steps, Ordering::SeqCst);
    }
    fn note(&self, _: &str) {}
}

/// Counts the steps of a training.
#[derive(Default)]
struct Counter {
    advances: AtomicU64,
}

impl Progress for Counter {
    fn start(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {
        self.advances.fetch_add(1, Ordering::SeqCst);
    }
    fn note(&self, _: &str) {}
}

/// Runs `train` whole, then killed after `steps` steps and taken up again; the second must end like the first with less work.
fn is_resumed<T: PartialEq>(steps: u64, train: impl Fn(Option<&Path>, &dyn Progress) -> T) {
    let counts = [Counter::default(), Counter::default()];
    let whole = train(None, &counts[0]);
    let dir = tempfile::tempdir().expect("folder");
    let killer = Killer { left: AtomicU64::new(steps) };
    std::panic::catch_unwind(AssertUnwindSafe(|| train(Some(dir.path()), &killer))).err().expect("is killed");
    let resumed = train(Some(dir.path()), &counts[1]);
    assert!(whole == resumed, "the resumed training ends elsewhere");
    let [all, rest] = counts.map(|c| c.advances.into_inner());
    assert!(rest < all, "{rest} steps after the kill of {all}");
}

#[test]
fn a_killed_distillation_goes_on_to_the_same_bytes() {
    let t = trained();
    let settings = DistillSettings { window: 5, epochs: 35, ..Default::default() };
    let (train, validation) = t.cases.split_at(N_TRAIN);
    is_resumed(24, |dir, progress| {
        let training = Training { checkpoint_dir: dir, ..Training::in_memory(progress) };
        let (encoder, history) = distill(&t.model, train, validation, &settings, 1, &training).expect("distils");
        (encoder, history.to_csv())
    });
}

#[test]
fn a_killed_calibration_goes_on_to_the_same_bytes_with_either_solver() {
    let t = trained();
    let events: Vec<Event> = t.cases[..6].iter().map(as_event).collect();
    let data = Data { simulations: &t.cases[..N_TRAIN], train: &events[..4], validation: &events[4..] };
    let adam = CalibrateSettings { solver: Solver::Adam, epochs: 90, threshold_every: 20, ..Default::default() };
    let gauss_newton = CalibrateSettings { penalty_ladder: vec![1.0, 0.1, 0.01], ..Default::default() };
    for (settings, steps) in [(adam, 60), (gauss_newton, 3)] {
        is_resumed(steps, |dir, progress| {
            let found = calibrate(&t.model, &t.encoder, &t.observation, &data, &settings, dir, progress);
            let found = found.expect("calibrates");
            (found.coefficients, found.mask, found.history.to_csv())
        });
    }
}

fn as_event(case: &Case) -> Event {
    Event { id: case.id.clone(), u: case.u.to_vec(), u_half: case.u_half.to_vec(), sparse: case.sparse.to_vec() }
}

#[test]
fn the_number_of_threads_changes_no_byte_of_the_model() {
    let (cases, _) = Synthetic { n_case: 6, duration_s: 4.0, ..column() }.cases(4);
    let (train, validation) = cases.split_at(4);
    let settings = PretrainSettings { epochs: 4, ..settings() };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
        pool.install(|| pretrain(train, validation, &settings, 5, &Training::in_memory(&Quiet)).expect("trains"))
    };
    assert!(run(1).0 == run(4).0);
}

#[test]
fn models_come_back_from_their_files_unchanged_and_describe_themselves() {
    let t = trained();
    let (source, sparse) = (tempfile::tempdir().expect("folder"), tempfile::tempdir().expect("folder"));
    let normalisation = Normalisation {
        input_std_m_s2: 0.123,
        channel_depth_m: t.observation.channel_depth_m.clone(),
        dense_std_m_s2: t.observation.dense_std_m_s2.clone(),
    };
    t.model.save(source.path(), &normalisation).expect("saves");
    let (model, back) = SourceModel::load(source.path()).expect("loads");
    assert!(model == t.model);
    assert_eq!(back, normalisation);
    t.encoder.save(sparse.path(), &t.observation).expect("saves");
    let (encoder, observation) = SparseEncoder::load(sparse.path()).expect("loads");
    assert!(encoder == t.encoder);
    assert_eq!(observation, t.observation);

    let card = std::fs::read_to_string(source.path().join("model.toml")).expect("card");
    assert!(card.contains("\"z1 z2\"") && card.contains("dz8/dt ="), "{card}");
    let mut broken = t.model.clone();
    broken.parameters[3] = f32::NAN;
    broken.save(source.path(), &normalisation).expect("saves");
    let refused = SourceModel::load(source.path()).expect_err("no number").to_string();
    assert!(refused.contains("value 3 of tensor `xi`") && refused.contains("is not finite"), "{refused}");
    std::fs::write(source.path().join("model.safetensors"), b"short").expect("writes");
    assert!(SourceModel::load(source.path()).is_err());
}

#[test]
fn a_checkpoint_is_read_by_safetensors_for_numpy() {
    let packages = ["safetensors==0.6.2", "numpy==2.3.3"];
    let Some(python) = python("safetensors-reader", "import safetensors.numpy, numpy", &packages) else { return };
    let t = trained();
    let dir = tempfile::tempdir().expect("folder");
    let normalisation =
        Normalisation { input_std_m_s2: 1.0, channel_depth_m: vec![0.0; 12], dense_std_m_s2: vec![1.0; 12] };
    t.model.save(dir.path(), &normalisation).expect("saves");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_checkpoint.py");
    let out = Command::new(python).arg(script).arg(dir.path().join("model.safetensors")).output().expect("runs");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = String::from_utf8_lossy(&out.stdout);
    let library = t.model.shape.library();
    let sizes = format!("{}x{}", library.n_term(), library.latent);
    assert!(text.contains(&format!("tensor\txi\tfloat32\t{sizes}\n")), "{text}");
    assert!(text.contains(&format!("tensor\tmask\tuint8\t{sizes}\n")), "{text}");
    assert!(text.contains("tensor\tencoder.0.weight\tfloat32\t24x36\n"), "{text}");
    let values: Vec<f32> = text
        .lines()
        .filter(|line| line.starts_with("xi\t"))
        .map(|line| line.rsplit('\t').next().and_then(|v| v.parse().ok()).expect("a number"))
        .collect();
    assert_eq!(values, t.model.coefficients());
}

#[test]
fn a_training_without_a_bounded_candidate_is_an_error() {
    let (cases, _) = Synthetic { n_case: 3, duration_s: 2.0, ..column() }.cases(2);
    let settings = PretrainSettings { epochs: 1, state_bound: 1.0, stress_factor: 100.0, ..settings() };
    let error =
        pretrain(&cases[..2], &cases[2..], &settings, 1, &Training::in_memory(&Quiet)).expect_err("nothing survives");
    assert!(error.to_string().contains("no candidate"), "{error}");
}

#[test]
fn a_published_recipe_without_linear_start_trains_too() {
    let (cases, _) = Synthetic { n_case: 6, duration_s: 4.0, ..column() }.cases(4);
    let settings = PretrainSettings { epochs: 20, ..settings() }.as_published();
    let (model, history) =
        pretrain(&cases[..4], &cases[4..], &settings, 1, &Training::in_memory(&Quiet)).expect("trains");
    assert!(model.shape.encoder().skip_range().is_none());
    let total = history.column("total").expect("column");
    assert!(total[20] < total[1], "{total:?}");
}
