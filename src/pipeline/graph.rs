//! Stages and who depends on whom.

use super::unfold::unfold;
use super::{Recipe, Stage};
use crate::error::{Error, Result};
use crate::registry::known;
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::{Dfs, Reversed};
use std::collections::{BTreeMap, BTreeSet};

/// One stage of a recipe, or one instance of it.
pub struct Node {
    /// `calibrate`, or `calibrate.EW` for an instance.
    pub name: String,
    /// Name in the recipe.
    pub family: String,
    /// Which instance: the element of the `each` list.
    pub instance: Option<String>,
    /// What does the work.
    pub stage: &'static dyn Stage,
    /// Role → outputs that play it.
    pub inputs: BTreeMap<String, Vec<Link>>,
    /// Node whose `manifest.toml` holds sections that stand in for those of the manifest of the site.
    pub manifest: Option<usize>,
    /// Files of its output and their names in the folder of the site: `metrics.json`, of an instance `metrics.EW.json`.
    pub publishes: Vec<(&'static str, String)>,
}

/// One output that plays a role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Link {
    /// Instance, where the role is played by all instances of a stage.
    pub instance: Option<String>,
    /// Index of the node.
    pub node: usize,
}

/// Stages and who depends on whom, in an order in which they can run.
pub struct Graph {
    about: String,
    nodes: Vec<Node>,
    edges: DiGraph<usize, ()>,
}

impl Graph {
    /// Unfolds `recipe` with the kinds of `stages` over the lists of `manifest`.
    ///
    /// # Errors
    /// Unknown stage kind or input, a name used twice, a cycle, an `each` that is no list of texts.
    pub fn new(recipe: &Recipe, stages: &[&'static dyn Stage], manifest: &toml::Table) -> Result<Self> {
        let place = |e: Error| e.at(format!("pipeline `{}`", recipe.source)).usage();
        let nodes = unfold(recipe, stages, manifest).map_err(place)?;
        let mut edges = DiGraph::new();
        for index in 0..nodes.len() {
            edges.add_node(index);
        }
        for (index, node) in nodes.iter().enumerate() {
            for dependency in node.dependencies() {
                edges.update_edge(NodeIndex::new(dependency), NodeIndex::new(index), ());
            }
        }
        Ok(Self { about: recipe.about.clone(), nodes, edges })
    }

    /// One line for people.
    pub fn about(&self) -> &str {
        &self.about
    }

    /// All nodes; each after those it depends on.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Indices of the nodes that `name` means: a stage (all its instances) or one instance.
    ///
    /// # Errors
    /// When there is none; the hint lists the names.
    pub fn select(&self, name: &str) -> Result<BTreeSet<usize>> {
        let is_meant = |n: &Node| n.name == name || n.family == name;
        let found: BTreeSet<usize> =
            self.nodes.iter().enumerate().filter(|(_, n)| is_meant(n)).map(|(i, _)| i).collect();
        if found.is_empty() {
            let names: Vec<&str> = self.nodes.iter().map(|n| n.name.as_str()).collect();
            return Err(Error::new(format!("the pipeline has no stage `{name}`")).hint(known(&names, name)).usage());
        }
        Ok(found)
    }

    /// `of` and everything that depends on it.
    pub(super) fn downstream(&self, of: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut reached = BTreeSet::new();
        for start in of {
            let mut walk = Dfs::new(&self.edges, NodeIndex::new(*start));
            while let Some(node) = walk.next(&self.edges) {
                reached.insert(node.index());
            }
        }
        reached
    }

    /// `of` and everything it depends on.
    pub(super) fn upstream(&self, of: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut reached = BTreeSet::new();
        for start in of {
            let mut walk = Dfs::new(Reversed(&self.edges), NodeIndex::new(*start));
            while let Some(node) = walk.next(Reversed(&self.edges)) {
                reached.insert(node.index());
            }
        }
        reached
    }

    /// The graph as a Mermaid flow chart.
    pub fn mermaid(&self) -> String {
        let mut text = String::from("flowchart LR\n");
        for (index, node) in self.nodes.iter().enumerate() {
            text += &format!("  n{index}[\"{}\"]\n", node.name);
        }
        for (from, to) in self.pairs() {
            text += &format!("  n{from} --> n{to}\n");
        }
        text
    }

    /// The graph in the language of Graphviz.
    pub fn dot(&self) -> String {
        let mut text = String::from("digraph pipeline {\n  rankdir = LR;\n  node [shape = box];\n");
        for (index, node) in self.nodes.iter().enumerate() {
            text += &format!("  n{index} [label = \"{}\"];\n", node.name);
        }
        for (from, to) in self.pairs() {
            text += &format!("  n{from} -> n{to};\n");
        }
        text + "}\n"
    }

    fn pairs(&self) -> Vec<(usize, usize)> {
        let ends = |e| self.edges.edge_endpoints(e).map(|(a, b)| (a.index(), b.index()));
        let mut pairs: Vec<_> = self.edges.edge_indices().filter_map(ends).collect();
        pairs.sort_unstable();
        pairs
    }
}

impl Node {
    /// Indices of the nodes whose outputs it needs.
    pub fn dependencies(&self) -> BTreeSet<usize> {
        self.inputs.values().flatten().map(|l| l.node).chain(self.manifest).collect()
    }
}
