//! One made-up event in every format that strong motion comes in (`record_formats/write.py`), and files that ObsPy writes: the same
//! accelerations, start, azimuth and depth come out of each.

use flare_pipe::records::{self, Channel, Orientation, RecordSettings, Records};
use flare_pipe::units::G_M_S2;
use std::f64::consts::TAU;
use std::io::Write as _;
use std::path::{Path, PathBuf};

#[path = "support/python.rs"]
mod python;

const N: usize = 400;
const DT_S: f64 = 0.01;
/// Azimuths of the channels; the fifth is vertical.
const AZIMUTH_DEG: [f64; 4] = [0.0, 90.0, 20.0, 110.0];

fn dir() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/record_formats")
}

/// Acceleration of channel `k` at sample `i`, m/s².
fn value(k: usize, i: usize) -> f64 {
    let (k, t) = (k as f64, i as f64 * DT_S);
    0.01 * (20.0 + 5.0 * k) * (TAU * (0.7 + 0.3 * k) * t).sin() * (-((t - 2.0) / 1.5).powi(2)).exp()
}

fn settings(format: &str, event: &str, channels: &str) -> RecordSettings {
    let text = format!(
        "format = '{format}'\ndir = '.'\ncomponents = ['NS', 'EW']\ntrain = ['{event}']\nvalidation = []\ntest = []\n[channels]\n{channels}"
    );
    toml::from_str(&text).expect("settings")
}

fn load(settings: &RecordSettings, dir: &Path) -> flare_pipe::error::Result<Records> {
    records::load(settings, dir, "base", &["top".to_string()])
}

/// Base and top of both components are channels 1 to 4, the top turned by 20° to north and east.
fn check(read: &Records, what: &str, tolerance_m_s2: f64) {
    assert_eq!(read.records.len(), 2, "{what}");
    let (sine, cosine) = 20.0f64.to_radians().sin_cos();
    for (component, (_, record)) in read.records.iter().enumerate() {
        assert_eq!((record.n_step(), record.dt_s), (N, DT_S), "{what}");
        for i in 0..N {
            let [x, y] = [value(3, i), value(4, i)];
            let top = if component == 0 { cosine * x - sine * y } else { sine * x + cosine * y };
            for (a, b) in [
                (record.input.acceleration_m_s2[i], value(component + 1, i)),
                (record.outputs[0].acceleration_m_s2[i], top),
            ] {
                assert!((a - b).abs() < tolerance_m_s2, "{what}, component {component}, sample {i}: {a} {b}");
            }
        }
        assert!(read.origins[component].remarks.iter().any(|r| r.contains("turned from")), "{what}");
    }
}

const BY_NUMBER: &str = "base = { NS = '1', EW = '2' }\ntop = { NS = '3', EW = '4' }";
const BY_FILE: &str = "base = { NS = '*_1.*', EW = '*_2.*' }\ntop = { NS = '*_3.*', EW = ['nothing', '*_4.*'] }";

#[test]
fn every_format_holds_the_same_event() {
    for (format, event, channels, start) in [
        ("cosmos", "20210301_cosmos", BY_NUMBER, Some("2021-03-01T07:30:15.25")),
        ("csmip", "20210301_csmip", BY_NUMBER, Some("2021-03-01T07:30:15.2")),
        ("smc", "20210301", BY_FILE, Some("2021-03-01T07:30:15.25")),
        ("at2", "RSN1_20210301", BY_FILE, None),
    ] {
        for format in [format, records::ANY] {
            let channels =
                if format == records::ANY && event == "20210301" { &BY_FILE.replace(".*", ".smc") } else { channels };
            let read = load(&settings(format, event, channels), &dir()).unwrap_or_else(|e| panic!("{format}: {e}"));
            check(&read, &format!("{format} {event}"), 1e-5);
            assert_eq!(read.origins[0].start.map(|start| start.to_string()).as_deref(), start, "{format}");
        }
        let all = records::channels(&settings(format, event, ""), &dir()).expect("channels");
        let all: Vec<Channel> = all.into_values().flatten().collect();
        assert_eq!(all.len(), 5, "{format}");
        for (channel, azimuth) in all.iter().zip(AZIMUTH_DEG) {
            assert_eq!(channel.orientation, Orientation::AzimuthDeg(azimuth), "{format}");
        }
        assert_eq!(all[4].orientation, Orientation::Vertical, "{format}");
    }
}

#[test]
fn archives_and_folders_hold_events_too_and_formats_may_be_mixed() {
    let place = tempfile::tempdir().expect("a folder");
    let bytes = |name: &str| std::fs::read(dir().join(name)).expect("a file");
    let mut zip = zip::ZipWriter::new(std::fs::File::create(place.path().join("2021A.zip")).expect("written"));
    for name in ["20210301_1.smc", "20210301_2.smc"] {
        zip.start_file(format!("inside/{name}"), zip::write::SimpleFileOptions::default()).expect("zip");
        zip.write_all(&bytes(name)).expect("zip");
    }
    zip.finish().expect("zip");
    let gz = std::fs::File::create(place.path().join("2021A.more.tar.gz")).expect("written");
    let mut tar = tar::Builder::new(flate2::write::GzEncoder::new(gz, flate2::Compression::fast()));
    tar.append_path_with_name(dir().join("20210301_cosmos.v2"), "deep/er/a.v2").expect("tar");
    tar.into_inner().expect("tar").finish().expect("gz");
    let channels = "base = { NS = '*_1.smc', EW = '*_2.smc' }\ntop = { NS = 'a.v2:3', EW = 'a.v2:4' }";
    check(&load(&settings("any", "2021A", channels), place.path()).expect("read"), "archives", 1e-5);
    let folder = place.path().join("2021B");
    std::fs::create_dir(&folder).expect("a folder");
    for k in 1..=4 {
        std::fs::copy(dir().join(format!("RSN1_20210301_{k}.AT2")), folder.join(format!("x_{k}.at2"))).expect("copied");
    }
    check(&load(&settings("any", "2021B", BY_FILE), place.path()).expect("read"), "a folder an event", 1e-5);
    let files = records::files(&settings("any", "2021B", BY_FILE), place.path()).expect("files");
    assert_eq!(files.len(), 4);
    let mixed = load(&settings("any", "2021", channels), place.path()).unwrap_err().to_string();
    assert!(mixed.contains("`2021`"), "`2021` is no event: a letter follows: {mixed}");
}

#[test]
fn what_does_not_fit_is_told_with_what_is_there() {
    let refused = |format: &str, event: &str, channels: &str| {
        let error = load(&settings(format, event, channels), &dir()).expect_err("refused");
        format!("{error}")
    };
    let none = refused("cosmos", "20210301_cosmos", "");
    assert!(none.contains("nothing says which channel is `base` in `NS`"), "{none}");
    assert!(none.contains("`20210301_cosmos.v2:3` (20°, 20 Deg (Rcrdr Chan 3) Location:Surface)"), "{none}");
    let two = refused("smc", "20210301", "base = { NS = '*.smc', EW = '*_2.*' }\ntop = { NS = '*_3.*', EW = '*_4.*' }");
    assert!(two.contains("two channels fit `base`"), "{two}");
    let vertical = refused("smc", "20210301", &BY_FILE.replace("_3", "_5"));
    assert!(vertical.contains("is vertical"), "{vertical}");
    let alone = refused("smc", "20210301", "base = { NS = '*_1.*' }\ntop = { NS = '*_3.*' }");
    assert!(alone.contains("nothing says which channel is `base` in `EW`"), "{alone}");
    let sensor = refused("smc", "20210301", &format!("{BY_FILE}\nroof = {{ NS = 'x' }}"));
    assert!(sensor.contains("`records.channels.roof` is of no sensor"), "{sensor}");
    let unit = RecordSettings {
        unit: Some(flare_pipe::units::AccelerationUnit::Gravity),
        ..settings("smc", "20210301", BY_FILE)
    };
    let unit = load(&unit, &dir()).expect_err("refused").to_string();
    assert!(unit.contains("the file says that it is in gal, but g is declared"), "{unit}");
}

#[test]
fn any_byte_of_a_text_file_may_be_wrong() {
    for file in ["20210301_cosmos.v2", "20210301_csmip.V2", "20210301_1.smc", "RSN1_20210301_1.AT2"] {
        let sound = std::fs::read(dir().join(file)).expect("a file");
        let head = sound.len().min(5000);
        survives(&sound, file, (0..head).step_by(7).chain((head..sound.len()).step_by(501)));
    }
}

#[test]
fn damaged_files_are_refused_by_line() {
    let place = tempfile::tempdir().expect("a folder");
    for (format, file, from, to, expected) in [
        (
            "cosmos",
            "20210301_cosmos.v2",
            "with 13 text lines",
            "with many text lines",
            "line 1 must hold the number of text lines",
        ),
        ("cosmos", "20210301_cosmos.v2", "     400 acceleration", "     401 acceleration", "must hold"),
        ("cosmos", "20210301_cosmos.v2", "units=cm/sec2(04)", "units=counts(50)", "no acceleration"),
        ("csmip", "20210301_csmip.V2", "Corrected accelerogram", "Uncorrected accelerogram", "volume 2 is read"),
        ("csmip", "20210301_csmip.V2", "points of accel data", "points of other data", "has no accelerations"),
        ("smc", "20210301_1.smc", "2 CORRECTED ACCELEROGRAM", "3 VELOCITY", "velocities and spectra are no records"),
        ("at2", "RSN1_20210301_1.AT2", "NPTS=  400", "NPTS=  401", "line 4 says 401 samples, 400 came"),
        ("at2", "RSN1_20210301_1.AT2", "IN UNITS OF G", "IN SOME UNIT", "nothing says in what unit"),
    ] {
        let text = std::fs::read_to_string(dir().join(file)).expect("a file");
        assert!(text.contains(from), "{file}: {from}");
        std::fs::write(place.path().join(file), text.replacen(from, to, 1)).expect("written");
        let event = file.split('.').next().expect("a stem");
        let found = records::channels(&settings(format, event, ""), place.path());
        let error = found.expect_err(expected).to_string();
        assert!(
            error.contains(expected) && error.contains(file) && error.contains("hint:"),
            "`{expected}` is not in:\n{error}"
        );
        for length in [0, 1, 80, text.len() / 2, text.len() - 100] {
            std::fs::write(place.path().join(file), &text[..length]).expect("written");
            let found = records::channels(&settings(format, event, ""), place.path());
            assert!(
                found.is_err() || found.is_ok_and(|c| c.into_values().flatten().count() < 5),
                "{file} cut to {length}"
            );
        }
    }
}

const OBSPY: &str = r#"
import sys
import numpy as np
from obspy import Stream, Trace, UTCDateTime
from obspy.core.inventory import Channel, Inventory, Network, Station
from obspy.core.inventory.response import InstrumentSensitivity, Response

place, n, dt = sys.argv[1], 400, 0.01
t = np.arange(n) * dt
START = UTCDateTime(2021, 3, 1, 7, 30, 15, 250000)
CODES = {1: ("00", "HN1"), 2: ("00", "HN2"), 3: ("10", "HN1"), 4: ("10", "HN2")}
AZIMUTHS = {1: 0, 2: 90, 3: 20, 4: 110}
GAIN = 4e7

def value(k):
    return 0.01 * (20 + 5 * k) * np.sin(2 * np.pi * (0.7 + 0.3 * k) * t) * np.exp(-(((t - 2) / 1.5) ** 2))

def stream(dtype, gain=GAIN):
    traces = []
    for k, (location, channel) in CODES.items():
        x = value(k) * (4e4 if dtype == "i2" else gain)
        header = dict(network="XX", station="ARR", location=location, channel=channel, starttime=START, sampling_rate=100.0)
        traces.append(Trace((x if dtype.startswith("f") else np.rint(x)).astype(dtype), header=header))
    return Stream(traces)

for encoding, dtype in [("STEIM1", "i4"), ("STEIM2", "i4"), ("INT32", "i4"), ("INT16", "i2"), ("FLOAT32", "f4"), ("FLOAT64", "f8")]:
    for length in (256, 4096):
        for order in ("<", ">"):
            name = f"{place}/{encoding}-{length}-{'little' if order == '<' else 'big'}.mseed"
            stream(dtype).write(name, format="MSEED", encoding=encoding, reclen=length, byteorder=order)

stream("f8", 1).write(f"{place}/physical.mseed", format="MSEED", encoding="FLOAT64", reclen=512)
gappy = stream("f8")
late = gappy[0].copy()
gappy[0].trim(endtime=START + 1.0)
late.trim(starttime=START + 1.5)
(gappy + Stream([late])).write(f"{place}/gap.mseed", format="MSEED", encoding="FLOAT64", reclen=512)

def channel(k):
    location, code = CODES[k]
    gain = InstrumentSensitivity(GAIN, 1.0, "M/S**2", "COUNTS")
    return Channel(code, location, 37, -122, 0, 30.0 if k < 3 else 0.0, azimuth=AZIMUTHS[k], dip=0, sample_rate=100, response=Response(instrument_sensitivity=gain))

station = Station("ARR", 37, -122, 0, channels=[channel(k) for k in CODES])
Inventory([Network("XX", [station])], source="made up").write(f"{place}/station.xml", format="STATIONXML")
"#;

#[test]
fn miniseed_and_stationxml_of_obspy_are_read() {
    let Some(python) = python::python("obspy", "import obspy", &["obspy"]) else { return };
    let place = tempfile::tempdir().expect("a folder");
    let out = std::process::Command::new(python).args(["-c", OBSPY]).arg(place.path()).output().expect("python");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let by_code = "base = { NS = '*.00.HN1', EW = '*.00.HN2' }\ntop = { NS = '*.10.HN1', EW = '*.10.HN2' }";
    let xml = place.path().join("station.xml");
    for (encoding, scale, tolerance) in [
        ("STEIM1", 1.0, 3e-8),
        ("STEIM2", 1.0, 3e-8),
        ("INT32", 1.0, 3e-8),
        ("INT16", 4e7 / 4e4, 3e-5),
        ("FLOAT32", 1.0, 3e-8),
        ("FLOAT64", 1.0, 1e-12),
    ] {
        for length in [256, 4096] {
            for order in ["little", "big"] {
                let event = format!("{encoding}-{length}-{order}");
                let wanted = settings("miniseed", &event, by_code);
                let mut read = load(&wanted, place.path()).unwrap_or_else(|e| panic!("{event}: {e}"));
                // Sixteen bits do not hold the counts of the gain that is stated.
                for record in read.records.iter_mut().map(|(_, r)| r) {
                    let sensors = std::iter::once(&mut record.input).chain(&mut record.outputs);
                    sensors.flat_map(|s| &mut s.acceleration_m_s2).for_each(|v| *v *= scale);
                }
                check(&read, &event, tolerance);
                assert_eq!(read.origins[0].start.map(|s| s.to_string()).as_deref(), Some("2021-03-01T07:30:15.25"));
            }
        }
    }
    let gap = load(&settings("miniseed", "gap", by_code), place.path()).expect_err("a gap").to_string();
    assert!(gap.contains("`XX.ARR.00.HN1`") && gap.contains("a gap of 0.490 s at 2021-03-01T07:30:16.75"), "{gap}");
    std::fs::remove_file(place.path().join("gap.mseed")).expect("removed");
    let all = records::channels(&settings("any", "INT32-256-big", ""), place.path()).expect("channels");
    let depths: Vec<Option<f64>> = all["INT32-256-big"].iter().map(|channel| channel.depth_m).collect();
    assert_eq!(depths, [Some(30.0), Some(30.0), Some(0.0), Some(0.0)]);
    std::fs::remove_file(&xml).expect("removed");
    let unknown = load(&settings("miniseed", "physical", by_code), place.path()).expect_err("no unit").to_string();
    assert!(unknown.contains("nothing says in what unit") && unknown.contains("StationXML"), "{unknown}");
    let unit = Some(flare_pipe::units::AccelerationUnit::Gravity);
    let read = load(&RecordSettings { unit, ..settings("miniseed", "physical", by_code) }, place.path()).expect("read");
    assert!((read.records[0].1.input.acceleration_m_s2[150] - G_M_S2 * value(1, 150)).abs() < 1e-9);
    let sound = std::fs::read(place.path().join("STEIM2-256-big.mseed")).expect("a file");
    survives(&sound, "damaged.mseed", (0..sound.len().min(600)).chain((600..sound.len()).step_by(37)));
}

/// Any byte of a file may be wrong: it is read or refused.
fn survives(sound: &[u8], name: &str, places: impl Iterator<Item = usize>) {
    let place = tempfile::tempdir().expect("a folder");
    let unit = Some(flare_pipe::units::AccelerationUnit::Gravity);
    let event = name.split('.').next().expect("a stem");
    for at in places {
        for with in [0u8, b'9', b'(', 0xff] {
            let mut bytes = sound.to_vec();
            bytes[at] = with;
            std::fs::write(place.path().join(name), &bytes).expect("written");
            let _ = records::channels(&RecordSettings { unit, ..settings("any", event, "") }, place.path());
        }
    }
}
