//! Trajectory files: what is written is what is read, by this program and by independent software, whole or not at all.

#[path = "support/python.rs"]
mod python_with;

use flare_pipe::dataset::{Header, Sample, Trajectory, TrajectoryWriter, read_trajectory};
use proptest::prelude::*;
use python_with::python;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

const N_STEP: usize = 400;
const N_DEPTH: usize = 40;

fn value(step: usize, channel: usize) -> f64 {
    0.3 * (0.05 * step as f64 - 0.1 * channel as f64).sin() * (1.0 + 0.02 * channel as f64)
}

fn header() -> Header {
    Header {
        id: "001".into(),
        dt_s: 0.005,
        depth_m: (0..N_DEPTH).map(|i| 0.0425 + 0.085 * i as f64).collect(),
        sensors: vec!["DHB11".into(), "DHB6".into(), "FA1-5".into()],
        metadata: BTreeMap::from([("site".into(), "lotung".into()), ("seed".into(), "1".into())]),
    }
}

fn write(path: &Path) {
    let mut writer = TrajectoryWriter::create(path, header()).unwrap();
    let mut response = vec![0.0; N_DEPTH];
    for step in 0..N_STEP {
        for (channel, v) in response.iter_mut().enumerate() {
            *v = value(step, channel);
        }
        let sensors = [value(step, 9), value(step, 5), value(step, 0)];
        let sample = Sample {
            time_s: step as f64 * 0.005,
            base_m_s2: value(step, N_DEPTH),
            response_m_s2: &response,
            surface_m_s2: value(step, 0) * 1.01,
            sensors_m_s2: &sensors,
        };
        writer.push(&sample).unwrap();
    }
    writer.note("newton_iterations", 1234);
    writer.finish().unwrap();
}

fn written() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("001.mcap");
    write(&path);
    (dir, path)
}

#[test]
fn a_trajectory_comes_back_as_written() {
    let (_dir, path) = written();
    let t: Trajectory = read_trajectory(&path).unwrap();
    assert_eq!((t.id.as_str(), t.dt_s, t.n_step(), t.n_depth()), ("001", 0.005, N_STEP, N_DEPTH));
    assert_eq!(t.depth_m, header().depth_m);
    assert_eq!((t.metadata["site"].as_str(), t.metadata["newton_iterations"].as_str()), ("lotung", "1234"));
    for step in 0..N_STEP {
        assert_eq!(t.base_m_s2[step], value(step, N_DEPTH));
        assert_eq!(t.surface_m_s2[step], value(step, 0) * 1.01);
        for channel in 0..N_DEPTH {
            assert_eq!(t.response_m_s2[step * N_DEPTH + channel], value(step, channel) as f32);
        }
    }
    assert_eq!(t.sensors[1].0, "DHB6");
    assert_eq!(t.sensors[1].1[77], value(77, 5));
    assert_eq!(t.response_at(3)[50], f64::from(value(50, 3) as f32));
}

#[test]
fn the_same_steps_give_the_same_bytes() {
    let ((_a, first), (_b, second)) = (written(), written());
    assert_eq!(std::fs::read(first).unwrap(), std::fs::read(second).unwrap());
}

#[test]
fn an_unfinished_trajectory_leaves_no_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("001.mcap");
    let mut writer = TrajectoryWriter::create(&path, header()).unwrap();
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    assert!(!path.exists());
    let bad = |response: &[f64], sensors: &[f64]| {
        let mut other = TrajectoryWriter::create(&dir.path().join("bad.mcap"), header()).unwrap();
        let sample =
            Sample { time_s: 0.0, base_m_s2: 0.0, response_m_s2: response, surface_m_s2: 0.0, sensors_m_s2: sensors };
        other.push(&sample).unwrap_err().to_string()
    };
    assert!(bad(&[0.0; 3], &[0.0; 3]).contains("3 element accelerations, the trajectory has 40"));
    assert!(bad(&[0.0; N_DEPTH], &[0.0]).contains("1 sensor accelerations, the trajectory has 3"));
    assert!(bad(&[f64::NAN; N_DEPTH], &[0.0; 3]).contains("not a finite number at 0.000 s"));
    writer.note("x", 1);
    drop(writer);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn a_missing_or_foreign_file_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("x.mcap");
    assert!(read_trajectory(&path).unwrap_err().to_string().contains("x.mcap"));
    for content in [&b""[..], b"hello", &[0x89, b'M', b'C', b'A', b'P', 0x30, b'\r', b'\n']] {
        std::fs::write(&path, content).unwrap();
        let error = read_trajectory(&path).unwrap_err();
        assert!(error.to_string().contains("x.mcap") && error.hint_text().unwrap().contains("delete it"));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn a_file_cut_off_anywhere_is_refused(share in 0.0f64..1.0) {
        let (_dir, path) = written();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..(share * bytes.len() as f64) as usize]).unwrap();
        prop_assert!(read_trajectory(&path).is_err());
    }

    #[test]
    fn a_flipped_byte_is_refused_or_harmless(share in 0.0f64..1.0, mask in 1u8..) {
        let (_dir, path) = written();
        let mut bytes = std::fs::read(&path).unwrap();
        let place = ((share * bytes.len() as f64) as usize).min(bytes.len() - 1);
        bytes[place] ^= mask;
        std::fs::write(&path, &bytes).unwrap();
        let whole = { write(&path); read_trajectory(&path).unwrap() };
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(read) = read_trajectory(&path) {
            prop_assert!(read == whole);
        }
    }
}

#[test]
fn independent_software_reads_the_values_that_were_written() {
    let packages = ["mcap==1.6.0", "mcap-protobuf-support==0.6.0"];
    let Some(python) = python("mcap-reader", "import mcap.reader, mcap_protobuf.decoder", &packages) else { return };
    let (_dir, path) = written();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_trajectory.py");
    let out = Command::new(python).arg(script).arg(&path).output().unwrap();
    let text = String::from_utf8_lossy(&out.stdout);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    // One line a value: topic, step, name, value; then metadata and counts.
    let mut n_value = 0;
    let mut metadata = BTreeMap::new();
    for line in text.lines() {
        let words: Vec<&str> = line.split('\t').collect();
        match words[..] {
            ["metadata", key, value] => {
                metadata.insert(key.to_string(), value.to_string());
            }
            [topic, step, name, got] => {
                let (step, got): (usize, f64) = (step.parse().unwrap(), got.parse().unwrap());
                let expected = match (topic, name) {
                    ("/base", _) => value(step, N_DEPTH),
                    ("/response", "surface") => value(step, 0) * 1.01,
                    ("/response", channel) => f64::from(value(step, channel.parse().unwrap()) as f32),
                    (_, "DHB11") => value(step, 9),
                    (_, "DHB6") => value(step, 5),
                    _ => value(step, 0),
                };
                assert_eq!(got, expected, "{line}");
                n_value += 1;
            }
            _ => panic!("{line}"),
        }
    }
    assert_eq!(n_value, N_STEP * (1 + N_DEPTH + 1 + 3));
    assert_eq!((metadata["site"].as_str(), metadata["n_step"].as_str()), ("lotung", "400"));
}
