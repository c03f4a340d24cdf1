//! What is to be done with each stage, and why: the one decision behind `plan` and `run`.

use super::executor::Slurm;
use super::parameters::{leaves, select};
use super::site::Memory;
use super::{Address, Change, Graph, OutsideFile, Parts, Site, State, Store};
use crate::error::{Context, Error, Result};
use serde::{Serialize, Serializer};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::PathBuf;

/// What of the pipeline is wanted. Names are those of stages or of instances.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// These stages and no others; empty means no such limit.
    pub only: Vec<String>,
    /// This stage and what depends on it.
    pub from: Option<String>,
    /// This stage and what it depends on.
    pub until: Option<String>,
    /// Stages to compute though they are stored; `all` is every one.
    pub force: Vec<String>,
    /// How many stages, and how many items, are computed at once.
    pub jobs: usize,
    /// The cluster that computes ensembles, if it is not this machine.
    pub slurm: Option<Slurm>,
}

impl Default for Options {
    fn default() -> Self {
        let jobs = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Self { only: Vec::new(), from: None, until: None, force: Vec::new(), jobs, slurm: None }
    }
}

/// What is to be done with a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Its output is stored.
    Cached,
    /// It will be computed.
    Run,
    /// Its key depends on an output that is not there yet; decided when it is.
    Wait,
    /// It is not among the stages asked for.
    Leave,
}

/// Why a stage is computed.
#[derive(Debug, Clone, PartialEq)]
pub enum Reason {
    /// This site has no output of it yet.
    NeverRun,
    /// It was asked for.
    Forced,
    /// The output is not usable, and why.
    Damaged(String),
    /// Same key as the last time, but the output is not in the cache any more.
    Removed,
    /// The last output is gone from the cache, so what changed since is not known.
    PreviousGone,
    /// A part of the key is other than the last time.
    Changed(Change),
    /// The named stage must be done first.
    WaitsFor(String),
    /// The stored output stands in for an outside file that is not there any more.
    FileGone(String),
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NeverRun => f.write_str("never run"),
            Self::Forced => f.write_str("forced"),
            Self::Damaged(why) => write!(f, "output damaged: {why}"),
            Self::Removed => f.write_str("output is not in the cache any more"),
            Self::PreviousGone => f.write_str("changed since an output that is not in the cache any more"),
            Self::Changed(change) => change.fmt(f),
            Self::WaitsFor(stage) => write!(f, "decided when `{stage}` is done"),
            Self::FileGone(file) => write!(f, "`{file}` is gone; what was made from it is kept"),
        }
    }
}

impl Serialize for Reason {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The decision about one stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Decision {
    /// Name in the pipeline.
    pub stage: String,
    /// Kind of stage.
    pub kind: &'static str,
    /// What is to be done.
    pub action: Action,
    /// Why; empty for what is stored, unless there is something to know about it.
    pub reasons: Vec<Reason>,
    /// Where its output lies or will lie, if that is known.
    pub entry: Option<Address>,
    /// What it took when it ran last, s.
    pub last_s: Option<f64>,
}

impl Decision {
    /// The reasons in one line, the first three of many.
    pub fn reason(&self) -> String {
        let mut texts: Vec<String> = self.reasons.iter().map(ToString::to_string).collect();
        if texts.len() > 4 {
            let n_more = texts.len() - 3;
            texts.truncate(3);
            texts.push(format!("and {n_more} more"));
        }
        texts.join("; ")
    }
}

/// A stage whose key is known.
#[derive(Debug, Clone)]
pub(super) struct Resolved {
    pub(super) parts: Parts,
    pub(super) address: Address,
    pub(super) parameters: toml::Table,
    /// Outside files that are gone; their content is known from the output that is stored.
    gone: Vec<String>,
}

/// Everything decisions need.
pub(super) struct Planner<'a> {
    pub(super) site: &'a Site<'a>,
    pub(super) graph: &'a Graph,
    pub(super) store: Store,
    pub(super) memory: Memory,
    selected: BTreeSet<usize>,
    forced: BTreeSet<usize>,
}

impl<'a> Planner<'a> {
    pub(super) fn new(site: &'a Site<'a>, graph: &'a Graph, options: &Options) -> Result<Self> {
        let selected = selection(graph, options)?;
        let mut forced = BTreeSet::new();
        for name in &options.force {
            if name == "all" {
                forced.extend(&selected);
                continue;
            }
            let named = graph.select(name)?;
            if named.is_disjoint(&selected) {
                return Err(Error::new(format!("`--force {name}`: that stage is not among those asked for")).usage());
            }
            forced.extend(named.intersection(&selected));
        }
        if site.name == "cache" {
            return Err(Error::new("a site cannot be named `cache`: its folder would be that of the cache").usage());
        }
        Ok(Self { site, graph, store: site.store(), memory: Memory::load(&site.dir()), selected, forced })
    }

    pub(super) fn is_forced(&self, node: usize) -> bool {
        self.forced.contains(&node)
    }

    /// The output of a node by content, with its items where these are handed on.
    pub(super) fn content(&self, node: usize, address: &Address) -> State {
        if self.graph.nodes()[node].stage.hands_on_items() {
            self.store.verify(address)
        } else {
            self.store.verify_files(address)
        }
    }

    /// The output of a node: by content where it is published or decides what comes after it, by size elsewhere.
    fn state(&self, node: usize, address: &Address) -> State {
        let nodes = self.graph.nodes();
        let is_looked_into =
            !nodes[node].publishes.is_empty() || nodes.iter().any(|other| other.manifest == Some(node));
        if is_looked_into { self.store.verify_files(address) } else { self.store.state(address) }
    }

    /// The key of a node, if everything it depends on is known.
    pub(super) fn resolve(&self, node: usize, resolved: &[Option<Resolved>]) -> Result<Option<Resolved>> {
        let node = &self.graph.nodes()[node];
        let of = |index: usize| resolved.get(index).and_then(Option::as_ref);
        let other_manifest = match node.manifest {
            None => None,
            Some(source) => match of(source).filter(|s| matches!(self.state(source, &s.address), State::Sound(_))) {
                None => return Ok(None),
                Some(source) => {
                    let mut manifest = self.site.manifest.clone();
                    manifest.extend(read_manifest(&self.store.dir(&source.address))?);
                    Some(manifest)
                }
            },
        };
        let manifest = other_manifest.as_ref().unwrap_or(self.site.manifest);
        let sections: Vec<&str> = node.stage.reads().iter().chain(node.stage.unkeyed()).copied().collect();
        let mut parameters = select(manifest, &sections);
        node.stage.narrow(&mut parameters);
        if let Some(instance) = &node.instance {
            parameters.insert("each".into(), instance.clone().into());
        }
        let mut inputs = BTreeMap::new();
        for (role, links) in &node.inputs {
            for link in links {
                let Some(input) = of(link.node) else { return Ok(None) };
                let role = link.instance.as_ref().map_or(role.clone(), |i| format!("{role}.{i}"));
                inputs.insert(role, input.parts.key());
            }
        }
        let mut parts = Parts {
            kind: node.stage.kind().to_string(),
            version: node.stage.version(),
            parameters: leaves(&parameters, node.stage.unkeyed()),
            inputs,
            files: Vec::new(),
        };
        let paths = node.stage.files(&parameters, self.site.manifest_dir)?;
        let (files, gone) = self.outside_files(&node.name, &parts, &paths)?;
        parts.files = files;
        Ok(Some(Resolved { address: parts.address(), parts, parameters, gone }))
    }

    /// The outside files of a node by content, and the names of those that are gone but were there when the output it used
    /// last was made from otherwise the same parts: that output stands.
    fn outside_files(&self, node: &str, parts: &Parts, paths: &[PathBuf]) -> Result<(Vec<OutsideFile>, Vec<String>)> {
        let previous = || {
            let last = self.memory.last(node)?;
            let stored = self.store.parts(&last)?;
            let is_same = Parts { files: Vec::new(), ..stored.clone() } == *parts && stored.files.len() == paths.len();
            (is_same && matches!(self.store.state(&last), State::Sound(_))).then_some(stored.files)
        };
        let (mut files, mut gone) = (Vec::new(), Vec::new());
        for (index, path) in paths.iter().enumerate() {
            let known = if path.exists() { None } else { previous().and_then(|files| files.into_iter().nth(index)) };
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            match known.filter(|file| file.name == name) {
                Some(file) => {
                    files.push(file);
                    gone.push(name);
                }
                None => files.push(OutsideFile::read(path).map_err(Error::usage)?),
            }
        }
        Ok((files, gone))
    }

    /// The decision about a node whose key is known.
    pub(super) fn decide(&self, index: usize, resolved: &Resolved) -> Decision {
        let node = &self.graph.nodes()[index];
        let state = self.state(index, &resolved.address);
        let is_sound = matches!(state, State::Sound(_));
        let last = self.memory.last(&node.name);
        let mut reasons = match state {
            _ if self.is_forced(index) => vec![Reason::Forced],
            State::Sound(_) => Vec::new(),
            State::Damaged(why) => vec![Reason::Damaged(why)],
            State::Missing => match last {
                None => vec![Reason::NeverRun],
                Some(last) if last == resolved.address => vec![Reason::Removed],
                Some(last) => match self.store.parts(&last) {
                    None => vec![Reason::PreviousGone],
                    Some(previous) => resolved.parts.changes_from(&previous).into_iter().map(Reason::Changed).collect(),
                },
            },
        };
        let action = match (is_sound && reasons.is_empty(), self.selected.contains(&index)) {
            (true, _) => Action::Cached,
            (false, true) => Action::Run,
            (false, false) => Action::Leave,
        };
        reasons.extend(resolved.gone.iter().cloned().map(Reason::FileGone));
        self.decision(index, action, reasons, Some(resolved.address.clone()))
    }

    fn decision(&self, index: usize, action: Action, reasons: Vec<Reason>, entry: Option<Address>) -> Decision {
        let node = &self.graph.nodes()[index];
        let last_s = self.memory.last(&node.name).and_then(|last| self.store.seconds(&last));
        Decision { stage: node.name.clone(), kind: node.stage.kind(), action, reasons, entry, last_s }
    }

    /// Decisions about all nodes, in order.
    pub(super) fn plan(&self) -> Result<(Vec<Decision>, Vec<Option<Resolved>>)> {
        let (mut decisions, mut resolved): (Vec<Decision>, Vec<Option<Resolved>>) = (Vec::new(), Vec::new());
        for (index, node) in self.graph.nodes().iter().enumerate() {
            let place = |e: Error| e.at(format!("stage `{}`", node.name));
            // A manifest that is about to be computed again says nothing yet.
            let is_open = node.manifest.is_some_and(|source| decisions[source].action != Action::Cached);
            let known = if is_open { None } else { self.resolve(index, &resolved).map_err(place)? };
            decisions.push(match &known {
                Some(known) => self.decide(index, known),
                None => {
                    let is_open = |d: &usize| resolved[*d].is_none() || node.manifest == Some(*d);
                    let awaited = node.dependencies().into_iter().find(is_open).unwrap_or_default();
                    let reasons = vec![Reason::WaitsFor(self.graph.nodes()[awaited].name.clone())];
                    let action = if self.selected.contains(&index) { Action::Wait } else { Action::Leave };
                    self.decision(index, action, reasons, None)
                }
            });
            resolved.push(known);
        }
        self.check_inputs(&decisions)?;
        Ok((decisions, resolved))
    }

    /// Whatever will be computed must find its inputs stored or among the stages asked for.
    fn check_inputs(&self, decisions: &[Decision]) -> Result<()> {
        for (index, decision) in decisions.iter().enumerate() {
            if !matches!(decision.action, Action::Run | Action::Wait) {
                continue;
            }
            let dependencies = self.graph.nodes()[index].dependencies();
            let absent: Vec<String> = dependencies
                .into_iter()
                .filter(|d| decisions[*d].action == Action::Leave)
                .map(|d| format!("`{}`", decisions[d].stage))
                .collect();
            if !absent.is_empty() {
                let (stage, list) = (&decision.stage, absent.join(", "));
                return Err(Error::new(format!(
                    "stage `{stage}` needs the output of {list}, which is not in the cache"
                ))
                .hint(format!("`flare-pipe run` with `--until {stage}` computes everything it needs"))
                .usage());
            }
        }
        Ok(())
    }
}

fn selection(graph: &Graph, options: &Options) -> Result<BTreeSet<usize>> {
    let mut selected: BTreeSet<usize> = (0..graph.nodes().len()).collect();
    if !options.only.is_empty() {
        let mut only = BTreeSet::new();
        for name in &options.only {
            only.extend(graph.select(name)?);
        }
        selected.retain(|n| only.contains(n));
    }
    if let Some(from) = &options.from {
        let reached = graph.downstream(&graph.select(from)?);
        selected.retain(|n| reached.contains(n));
    }
    if let Some(until) = &options.until {
        let reached = graph.upstream(&graph.select(until)?);
        selected.retain(|n| reached.contains(n));
    }
    if selected.is_empty() {
        return Err(Error::new("no stage is asked for: `--only`, `--from` and `--until` have none in common").usage());
    }
    Ok(selected)
}

fn read_manifest(entry: &std::path::Path) -> Result<toml::Table> {
    let path = entry.join("manifest.toml");
    let what = || format!("cannot read `{}`", path.display());
    toml::from_str(&std::fs::read_to_string(&path).context(what)?).context(what)
}
