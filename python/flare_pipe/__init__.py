"""The command ``flare-pipe`` and its results in pandas and xarray.

>>> import flare_pipe
>>> flare_pipe.run("mysite.toml")["answer"]["lines"]
>>> tables = flare_pipe.tables("mysite.toml")
>>> tables["errors"].groupby("model").nrmse_percent.median()
>>> flare_pipe.histories(tables).sel(sensor="surface", model="corrected")

Every function takes the path of a manifest, and further arguments of the command as they are typed: ``"--set", "records.unit=g"``.
"""

import json
import pathlib
import shutil
import subprocess
import sys
import tempfile

import pandas

__all__ = ["FlarePipeError", "answer", "files", "histories", "run", "tables"]


class FlarePipeError(RuntimeError):
    """What the command said went wrong: ``what``, ``at`` (innermost place first), ``hint`` and ``exit_status``."""

    def __init__(self, error):
        super().__init__(error["text"])
        self.what, self.at = error["what"], error["at"]
        self.hint, self.exit_status = error["hint"], error["exit_status"]


def _command():
    """The command that came with this package, or the one in the path."""
    beside = pathlib.Path(sys.executable).parent
    found = shutil.which("flare-pipe", path=str(beside)) or shutil.which("flare-pipe")
    if found is None:
        raise FileNotFoundError("there is no command `flare-pipe`: `pip install .` or `cargo install --path .` in its repository")
    return found


def _said(*arguments):
    """What the command prints as JSON; its progress goes where that of this process goes."""
    done = subprocess.run([_command(), *map(str, arguments), "--json"], stdout=subprocess.PIPE, text=True)
    said = json.loads(done.stdout) if done.stdout.strip() else None
    if done.returncode != 0:
        failures = (said or {}).get("failures") or []
        error = (said or {}).get("error") or (failures[0]["error"] if failures else None)
        if isinstance(error, dict):
            raise FlarePipeError(error)
        raise RuntimeError(error or f"`flare-pipe` ended with {done.returncode}")
    return said


def run(site, *options):
    """Runs the pipeline of a site, what is stored apart; decisions, and the answer with the paths of its files."""
    return _said("run", site, *options)


def answer(site, *options):
    """``loop.json`` of a site that has been run: verdict, effects with intervals, what remains, errors of every event."""
    path = run(site, *options)["answer"]["files"]["loop"]
    return json.loads(pathlib.Path(path).read_text(encoding="utf-8"))


def files(site, stage, *options):
    """Paths of what a stage has stored: trajectories of ``simulate`` as MCAP, the model of ``pretrain`` as safetensors, say."""
    return [pathlib.Path(path) for path in _said("show", "files", site, stage, *options)]


def tables(site, *options, folder=None):
    """Histories, spectra, transfer functions, errors and values over depth of a closed loop, one DataFrame each, by name.

    The files that they are read from stay in ``folder`` where that is given.
    """
    with tempfile.TemporaryDirectory() as scratch:
        files = map(pathlib.Path, _said("export", site, "-o", folder or scratch, *options))
        named = {"event": str, "component": str}
        return {file.stem: pandas.read_csv(file, dtype=named) for file in files if file.suffix == ".csv"}


def histories(tables):
    """The histories of :func:`tables` as an xarray by event, component, sensor, model and time in s; m/s², NaN where there is none."""
    keys = ["event", "component", "sensor", "model", "time_s"]
    return tables["histories"].set_index(keys)["acceleration_m_s2"].to_xarray()
