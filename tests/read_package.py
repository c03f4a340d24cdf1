"""Reads a site's results by the Python package: read_package.py MANIFEST [ARGUMENT …]."""

import sys

import flare_pipe

site, *options = sys.argv[1:]
found = flare_pipe.answer(site, *options)
assert found["verdict"] in ("none", "known", "ambiguous", "unknown")
tables = flare_pipe.tables(site, *options)
assert set(tables) == {"histories", "spectra", "transfer", "errors", "depth"}, set(tables)
recorded = flare_pipe.histories(tables).sel(model="record")
event, component = (str(recorded[name].values[0]) for name in ("event", "component"))
one = tables["histories"].query("event == @event and component == @component and sensor == 'input'")
assert float(abs(recorded.sel(event=event, component=component, sensor="input")).max()) == one.acceleration_m_s2.abs().max()
try:
    flare_pipe.run("nowhere.toml")
except flare_pipe.FlarePipeError as error:
    assert error.exit_status == 2 and "nowhere.toml" in error.what and error.hint
else:
    raise AssertionError("a manifest that is not there was run")
print(found["verdict"], len(tables["histories"]))
