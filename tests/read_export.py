"""Reads an export with pandas and mcap: prints what the test compares, one line each."""

import json
import sys
from pathlib import Path

import pandas
from mcap.reader import make_reader

folder = Path(sys.argv[1])
histories = pandas.read_csv(folder / "histories.csv")
assert list(histories) == ["event", "component", "sensor", "model", "time_s", "acceleration_m_s2"]
spectra = pandas.read_csv(folder / "spectra.csv")
for name in ("transfer.csv", "errors.csv", "depth.csv"):
    assert len(pandas.read_csv(folder / name)) > 0, name
layout = json.loads((folder / "foxglove.json").read_text())
assert layout["configById"] and layout["layout"]
for path in sorted(folder.glob("*.mcap")):
    event, component = path.stem.rsplit(".", 1)
    here = histories[(histories.event == event) & (histories.component == component)]
    with open(path, "rb") as stream:
        peaks, last, count = {}, -1, 0
        for _, channel, message in make_reader(stream).iter_messages():
            assert message.log_time >= last
            last, count = message.log_time, count + 1
            value = json.loads(message.data)
            key = "stress_kpa" if "/depth/" in channel.topic else "acceleration_m_s2"
            peaks[channel.topic] = max(peaks.get(channel.topic, 0.0), abs(value[key]))
    for (sensor, model), rows in here.groupby(["sensor", "model"]):
        peak = rows.acceleration_m_s2.abs().max()
        assert abs(peaks[f"/{model}/{sensor}"] / peak - 1) < 1e-4, (path, sensor, model)
    depths = [topic for topic in peaks if "/depth/" in topic]
    print(event, component, len(depths), here.model.nunique(), sep="\t")
