//! Everything that reads files of others: what they read, a sound example, and the reading.

use flare_pipe::error::{Error, Result};
use flare_pipe::flare::{
    DistillSettings, Normalisation, PretrainSettings, SourceModel, SparseEncoder, Training, distill, pretrain,
};
use flare_pipe::manifest::Manifest;
use flare_pipe::pipeline::Recipe;
use flare_pipe::progress::Quiet;
use flare_pipe::records::{self, RecordSettings};
use flare_pipe::twin::{Matrix, Truth};
use flare_pipe::{dataset, records::Channel};
use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::sync::OnceLock;

#[allow(dead_code, reason = "other tests use more of it")]
#[path = "synthetic_column.rs"]
mod synthetic_column;
use synthetic_column::Synthetic;

/// One that reads.
pub struct Reader {
    /// For people, and on a command line.
    pub name: &'static str,
    /// Name of the file, below a folder.
    pub file: &'static str,
    /// Puts sound files into a folder.
    pub prepare: fn(&Path) -> Result<()>,
    /// Reads the file in its folder.
    pub read: fn(&Path) -> Result<()>,
}

/// All of them.
pub const READERS: &[Reader] = &[
    Reader {
        name: "manifest",
        file: "site.toml",
        prepare: |d| shipped(d, "configs/smoke.toml", "site.toml"),
        read: manifest,
    },
    Reader {
        name: "truth",
        file: "truth.toml",
        prepare: |d| shipped(d, "configs/truth/smoke.toml", "truth.toml"),
        read: truth,
    },
    Reader { name: "matrix", file: "matrix.toml", prepare: matrix_with_truth, read: matrix },
    Reader {
        name: "pipeline",
        file: "p.toml",
        prepare: |d| shipped(d, "pipelines/close-loop.toml", "p.toml"),
        read: recipe,
    },
    Reader { name: "csv", file: "E1.NS.csv", prepare: csv, read: |d| records_of("csv", d) },
    Reader { name: "kiknet", file: "E1.NS1", prepare: kiknet, read: |d| records_of("kiknet", d) },
    Reader {
        name: "cosmos",
        file: "a.v2",
        prepare: |d| example(d, "20210301_cosmos.v2", "a.v2"),
        read: |d| records_of("cosmos", d),
    },
    Reader {
        name: "csmip",
        file: "a.V2",
        prepare: |d| example(d, "20210301_csmip.V2", "a.V2"),
        read: |d| records_of("csmip", d),
    },
    Reader {
        name: "smc",
        file: "a.smc",
        prepare: |d| example(d, "20210301_1.smc", "a.smc"),
        read: |d| records_of("smc", d),
    },
    Reader {
        name: "at2",
        file: "a.AT2",
        prepare: |d| example(d, "RSN1_20210301_1.AT2", "a.AT2"),
        read: |d| records_of("at2", d),
    },
    Reader { name: "miniseed", file: "a.mseed", prepare: miniseed, read: |d| records_of("miniseed", d) },
    Reader { name: "zip", file: "a.zip", prepare: zip, read: |d| records_of(records::ANY, d) },
    Reader { name: "mcap", file: "a.mcap", prepare: mcap, read: |d| records_of("mcap", d) },
    Reader {
        name: "trajectory",
        file: "a.mcap",
        prepare: trajectory,
        read: |d| dataset::read_trajectory(&d.join("a.mcap")).map(|_| ()),
    },
    Reader { name: "model", file: "model.safetensors", prepare: model, read: |d| SourceModel::load(d).map(|_| ()) },
    Reader { name: "card of a model", file: "model.toml", prepare: model, read: |d| SourceModel::load(d).map(|_| ()) },
    Reader {
        name: "card of an encoder",
        file: "model.toml",
        prepare: encoder,
        read: |d| SparseEncoder::load(d).map(|_| ()),
    },
    Reader { name: "checkpoint", file: "training.state", prepare: |d| resumed(d).map(|_| ()), read: checkpoint },
];

/// The folder of the project, wherever in it this is built.
fn root() -> &'static Path {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().find(|dir| dir.join("configs").is_dir()).expect("within the project")
}

fn put(folder: &Path, name: &str, bytes: &[u8]) -> Result<()> {
    let path = folder.join(name);
    let done = path.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(&path, bytes));
    done.map_err(|e| Error::new("cannot write").cause(e))
}

fn shipped(folder: &Path, from: &str, to: &str) -> Result<()> {
    put(folder, to, &fs::read(root().join(from)).expect("a shipped file"))
}

fn example(folder: &Path, from: &str, to: &str) -> Result<()> {
    shipped(folder, &format!("tests/record_formats/{from}"), to)
}

fn manifest(folder: &Path) -> Result<()> {
    Manifest::load(&folder.join("site.toml"), &[]).map(|_| ())
}

fn truth(folder: &Path) -> Result<()> {
    Truth::load(&folder.join("truth.toml")).map(|_| ())
}

fn matrix_with_truth(folder: &Path) -> Result<()> {
    shipped(folder, "configs/truth/smoke.toml", "../truth/smoke.toml")?;
    shipped(folder, "configs/matrix/smoke.toml", "matrix.toml")
}

fn matrix(folder: &Path) -> Result<()> {
    Matrix::load(&folder.join("matrix.toml")).map(|_| ())
}

fn recipe(folder: &Path) -> Result<()> {
    Recipe::load(&folder.join("p.toml")).map(|_| ())
}

/// Reads a folder of records and asserts that what is read is finite.
fn records_of(format: &str, folder: &Path) -> Result<()> {
    // The others say it themselves.
    let unit = if ["csv", "miniseed"].contains(&format) { "unit = 'gal'" } else { "" };
    let text = format!(
        "format = '{format}'\ndir = '.'\n{unit}\ncomponents = ['NS']\ntrain = ['E1']\nvalidation = []\ntest = []\n"
    );
    let settings: RecordSettings = toml::from_str(&text).expect("settings");
    let finite = |x: &[f64]| assert!(x.iter().all(|v| v.is_finite()), "a value that is not finite was read");
    if format == "csv" {
        let read = records::load(&settings, folder, "base", &["top".to_string()])?;
        for (_, record) in &read.records {
            record.sensors().for_each(|sensor| finite(&sensor.acceleration_m_s2));
        }
        return Ok(());
    }
    let channels = records::channels(&settings, folder)?;
    channels.values().flatten().for_each(|channel: &Channel| finite(&channel.acceleration_m_s2));
    Ok(())
}

fn csv(folder: &Path) -> Result<()> {
    let row =
        |i: usize| format!("{:.2},{},{}\n", i as f64 * 0.01, (i as f64 * 0.3).sin(), 1.5 * (i as f64 * 0.3).cos());
    let text: String = (0..60).map(row).collect();
    put(folder, "E1.NS.csv", format!("# unit: gal\ntime_s,base,top\n{text}").as_bytes())
}

fn kiknet(folder: &Path) -> Result<()> {
    let labels = [
        ("Origin Time", "2024/01/01 16:10:00"),
        ("Lat.", "37.5"),
        ("Long.", "137.3"),
        ("Depth. (km)", "16"),
        ("Mag.", "7.6"),
        ("Station Code", "AAAA01"),
        ("Station Lat.", "37.1"),
        ("Station Long.", "138.0"),
        ("Station Height(m)", "130"),
        ("Record Time", "2024/01/01 16:10:40"),
        ("Sampling Freq(Hz)", "100Hz"),
        ("Duration Time(s)", "1"),
        ("Dir.", "4"),
        ("Scale Factor", "2000(gal)/8388608"),
        ("Max. Acc. (gal)", "0.238"),
        ("Last Correction", "2024/01/01 16:10:25"),
        ("Memo.", ""),
    ];
    let header: String = labels.map(|(label, value)| format!("{label:18}{value}\n")).concat();
    let counts: Vec<String> = (0..100).map(|i| format!("{:9}", if i % 2 == 0 { 1000 } else { -1000 })).collect();
    let rows: String = counts.chunks(8).map(|row| format!("{}\n", row.concat())).collect();
    put(folder, "E1.NS1", format!("{header}{rows}").as_bytes())
}

/// A record of 100 integers with its length in blockette 1000.
fn miniseed(folder: &Path) -> Result<()> {
    let mut bytes = b"000001D AAAA 00HNZXX".to_vec();
    bytes.extend(2024u16.to_be_bytes());
    bytes.extend(1u16.to_be_bytes());
    bytes.extend([7, 30, 15, 0, 0, 0]);
    bytes.extend(100u16.to_be_bytes());
    bytes.extend(100i16.to_be_bytes());
    bytes.extend(1i16.to_be_bytes());
    bytes.extend([0, 0, 0, 1, 0, 0, 0, 0]);
    bytes.extend(64u16.to_be_bytes());
    bytes.extend(48u16.to_be_bytes());
    bytes.extend(1000u16.to_be_bytes());
    bytes.extend(0u16.to_be_bytes());
    bytes.extend([3, 1, 9, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    bytes.truncate(64);
    (0..100i32).for_each(|i| bytes.extend((i * 37 % 101 - 50).to_be_bytes()));
    bytes.resize(512, 0);
    put(folder, "a.mseed", &bytes)
}

fn zip(folder: &Path) -> Result<()> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let from = root().join("tests/record_formats/20210301_1.smc");
    writer.start_file("a.smc", zip::write::SimpleFileOptions::default()).expect("begun");
    writer.write_all(&fs::read(from).expect("an example")).expect("written");
    put(folder, "a.zip", writer.finish().expect("whole").get_ref())
}

fn mcap(folder: &Path) -> Result<()> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    // Without checksums, so that what is changed inside of a chunk is read.
    let options = mcap::WriteOptions::new().compression(None).calculate_chunk_crcs(false);
    let options = options.calculate_data_section_crc(false).calculate_summary_section_crc(false);
    let mut writer = options.create(&mut bytes).expect("begun");
    let schema = writer.add_schema("Acceleration", "jsonschema", b"{}").expect("a schema");
    let channel = writer.add_channel(schema, "/record/base", "json", &Default::default()).expect("a channel");
    for i in 0..60u32 {
        let time = u64::from(i) * 10_000_000;
        let header =
            mcap::records::MessageHeader { channel_id: channel, sequence: i, log_time: time, publish_time: time };
        let text = format!("{{\"acceleration_m_s2\": {}}}", (f64::from(i) * 0.3).sin());
        writer.write_to_known_channel(&header, text.as_bytes()).expect("written");
    }
    writer.finish().expect("whole");
    drop(writer);
    put(folder, "a.mcap", bytes.get_ref())
}

/// A training that goes on from what is in `folder`, and leaves its state there.
fn resumed(folder: &Path) -> Result<SourceModel> {
    fs::create_dir_all(folder).expect("made");
    let (cases, _) = small_column().cases(3);
    let settings = PretrainSettings { validate_every: 1, checkpoint_every: 1, ..small_training() };
    let training = Training { checkpoint_dir: Some(folder), ..Training::in_memory(&Quiet) };
    pretrain(&cases[..3], &cases[3..], &settings, 1, &training).map(|(model, _)| model)
}

/// Goes on from a state, whatever it is, and asserts that what comes of it is what comes of none.
fn checkpoint(folder: &Path) -> Result<()> {
    static ALONE: OnceLock<Vec<f32>> = OnceLock::new();
    let alone = ALONE.get_or_init(|| {
        let empty = tempfile::tempdir().expect("a folder");
        resumed(empty.path()).expect("a model").parameters
    });
    assert!(resumed(folder)?.parameters == *alone, "a damaged state has changed the model");
    Ok(())
}

fn small_column() -> Synthetic {
    Synthetic { n_case: 4, duration_s: 2.0, channels: 4, sensor_depth_m: vec![0.0], ..Default::default() }
}

fn small_training() -> PretrainSettings {
    PretrainSettings {
        latent: 2,
        channels: 4,
        encoder_hidden: vec![4],
        decoder_hidden: vec![4],
        epochs: 1,
        polish_every: 1,
        ..Default::default()
    }
}

/// A model that has learned next to nothing, and its encoder.
fn trained(folder: &Path, is_sparse: bool) -> Result<()> {
    fs::create_dir_all(folder).expect("made");
    let (cases, observation) = small_column().cases(3);
    let (model, _) = pretrain(&cases[..3], &cases[3..], &small_training(), 1, &Training::in_memory(&Quiet))?;
    if is_sparse {
        let settings = DistillSettings { window: 5, hidden: vec![4], epochs: 1, ..Default::default() };
        let (encoder, _) = distill(&model, &cases[..3], &cases[3..], &settings, 1, &Training::in_memory(&Quiet))?;
        return encoder.save(folder, &observation);
    }
    let (channel_depth_m, dense_std_m_s2) = (observation.channel_depth_m, observation.dense_std_m_s2);
    model.save(folder, &Normalisation { input_std_m_s2: 1.0, channel_depth_m, dense_std_m_s2 })
}

fn model(folder: &Path) -> Result<()> {
    trained(folder, false)
}

fn encoder(folder: &Path) -> Result<()> {
    trained(folder, true)
}

fn trajectory(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).expect("made");
    let header = dataset::Header {
        id: "001".into(),
        dt_s: 0.01,
        depth_m: vec![1.0, 2.0, 3.0],
        sensors: vec!["top".into()],
        metadata: Default::default(),
    };
    let mut writer = dataset::TrajectoryWriter::create(&folder.join("a.mcap"), header)?;
    for i in 0..50 {
        let a = (f64::from(i) * 0.3).sin();
        writer.push(&dataset::Sample {
            time_s: f64::from(i) * 0.01,
            base_m_s2: a,
            response_m_s2: &[a, 1.1 * a, 1.2 * a],
            surface_m_s2: 1.3 * a,
            sensors_m_s2: &[1.3 * a],
        })?;
    }
    writer.finish()
}
