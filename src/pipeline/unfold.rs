//! From a recipe to nodes: which instances there are, what plays their roles, and an order in which they can run.

use super::parameters::lookup;
use super::{Link, Node, Recipe, RecipeStage, Stage};
use crate::error::{Error, Result};
use crate::registry::known;
use petgraph::Direction;
use petgraph::algo::tarjan_scc;
use petgraph::graph::{DiGraph, NodeIndex};
use std::collections::{BTreeMap, BTreeSet};

/// Nodes, each after those it depends on.
pub(super) fn unfold(recipe: &Recipe, stages: &[&'static dyn Stage], manifest: &toml::Table) -> Result<Vec<Node>> {
    let families = families(recipe)?;
    let order = sort(recipe, &families)?;
    let mut nodes: Vec<Node> = Vec::new();
    for index in order {
        let typed = &recipe.stages[index];
        let place = |e: Error| e.at(format!("stage `{}`", typed.name));
        let stage = find(stages, typed.kind()).map_err(place)?;
        for instance in instances(typed, manifest).map_err(place)? {
            let each = instance.as_deref().zip(typed.each.as_deref());
            let mut inputs = BTreeMap::new();
            for (role, source) in &typed.inputs {
                inputs.insert(role.clone(), links(recipe, &nodes, source, each).map_err(place)?);
            }
            let manifest = match &typed.manifest {
                None => None,
                Some(source) => match links(recipe, &nodes, source, each).map_err(place)?.as_slice() {
                    [one] => Some(one.node),
                    _ => {
                        return Err(place(Error::new(format!("`manifest = \"{source}\"` names several instances"))));
                    }
                },
            };
            let name = instance.as_ref().map_or(typed.name.clone(), |i| format!("{}.{i}", typed.name));
            let names = stage.publishes().iter().filter(|_| typed.publish);
            let publishes = names.map(|file| (*file, published_name(file, instance.as_deref()))).collect();
            let node = Node { name, family: typed.name.clone(), instance, stage, inputs, manifest, publishes };
            refuse_clash(&nodes, &node).map_err(place)?;
            nodes.push(node);
        }
    }
    Ok(nodes)
}

fn published_name(file: &str, instance: Option<&str>) -> String {
    match (instance, file.rsplit_once('.')) {
        (None, _) => file.to_string(),
        (Some(instance), Some((stem, ending))) => format!("{stem}.{instance}.{ending}"),
        (Some(instance), None) => format!("{file}.{instance}"),
    }
}

/// Two stages that publish one name would overwrite each other on every run.
fn refuse_clash(nodes: &[Node], new: &Node) -> Result<()> {
    for (_, name) in &new.publishes {
        if let Some(other) = nodes.iter().find(|n| n.publishes.iter().any(|(_, taken)| taken == name)) {
            return Err(Error::new(format!("`{name}` is published by `{}` already", other.name))
                .hint(format!("add `publish = false` to `{}` or to `{}`", other.family, new.family)));
        }
    }
    Ok(())
}

fn find(stages: &[&'static dyn Stage], kind: &str) -> Result<&'static dyn Stage> {
    stages.iter().copied().find(|s| s.kind() == kind).ok_or_else(|| {
        let kinds: Vec<&str> = stages.iter().map(|s| s.kind()).collect();
        Error::new(format!("unknown stage kind `{kind}`")).hint(known(&kinds, kind))
    })
}

/// Name → index in the recipe.
fn families(recipe: &Recipe) -> Result<BTreeMap<&str, usize>> {
    let mut families = BTreeMap::new();
    for (index, stage) in recipe.stages.iter().enumerate() {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if stage.name.is_empty() || !stage.name.chars().all(is_plain) {
            return Err(Error::new(format!("stage name `{}` must be letters, digits, `-` and `_`", stage.name)));
        }
        if families.insert(stage.name.as_str(), index).is_some() {
            return Err(Error::new(format!("two stages are named `{}`", stage.name))
                .hint("give one of them another `name`; both may keep the same `kind`"));
        }
    }
    Ok(families)
}

/// Indices of the stages of the recipe, each after those it reads, as near to the order of the file as that allows.
fn sort(recipe: &Recipe, families: &BTreeMap<&str, usize>) -> Result<Vec<usize>> {
    let names: Vec<&str> = recipe.stages.iter().map(|s| s.name.as_str()).collect();
    let mut edges: DiGraph<(), ()> = DiGraph::new();
    for _ in &names {
        edges.add_node(());
    }
    for (index, stage) in recipe.stages.iter().enumerate() {
        for source in stage.inputs.values().chain(&stage.manifest) {
            let family = source.split('.').next().unwrap_or(source);
            let from = families.get(family).ok_or_else(|| {
                Error::new(format!("input `{source}` is no stage of the pipeline"))
                    .at(format!("stage `{}`", stage.name))
                    .hint(known(&names, family))
            })?;
            edges.update_edge(NodeIndex::new(*from), NodeIndex::new(index), ());
        }
    }
    let is_loop = |group: &Vec<NodeIndex>| group.len() > 1 || edges.contains_edge(group[0], group[0]);
    if let Some(mut group) = tarjan_scc(&edges).into_iter().find(is_loop) {
        group.sort();
        let list = group.iter().map(|n| format!("`{}`", names[n.index()])).collect::<Vec<_>>().join(", ");
        return Err(Error::new(format!("stages wait for each other in a circle: {list}"))
            .hint("take one of the inputs among them away"));
    }
    let mut order: Vec<usize> = Vec::new();
    while order.len() < names.len() {
        let is_ready =
            |n: NodeIndex| edges.neighbors_directed(n, Direction::Incoming).all(|d| order.contains(&d.index()));
        let next = (0..names.len()).find(|i| !order.contains(i) && is_ready(NodeIndex::new(*i)));
        order.extend(next); // there is one: the graph has no cycle
    }
    Ok(order)
}

fn instances(stage: &RecipeStage, manifest: &toml::Table) -> Result<Vec<Option<String>>> {
    let Some(each) = &stage.each else { return Ok(vec![None]) };
    let list = lookup(manifest, each).and_then(toml::Value::as_array);
    let texts: Option<Vec<String>> = list.and_then(|l| l.iter().map(|v| v.as_str().map(String::from)).collect());
    let Some(texts) = texts.filter(|t| !t.is_empty()) else {
        return Err(Error::new(format!(
            "`each = \"{each}\"` must name a list of texts of the site manifest, one or more"
        ))
        .hint(format!("add `{each}` to the manifest or take another pipeline")));
    };
    let distinct: BTreeSet<&String> = texts.iter().collect();
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if distinct.len() < texts.len() || !texts.iter().all(|t| !t.is_empty() && t.chars().all(is_plain)) {
        return Err(Error::new(format!("`{each}` must be distinct words of letters, digits, `-` and `_`")));
    }
    Ok(texts.into_iter().map(Some).collect())
}

/// What `source` means to an instance: one node, the same instance of a stage over the same list, or all instances.
fn links(recipe: &Recipe, nodes: &[Node], source: &str, each: Option<(&str, &str)>) -> Result<Vec<Link>> {
    if let Some(node) = nodes.iter().position(|n| n.name == source) {
        return Ok(vec![Link { instance: None, node }]);
    }
    let of_family = || nodes.iter().enumerate().filter(|(_, n)| n.family == source);
    let list = recipe.stages.iter().find(|s| s.name == source).and_then(|s| s.each.as_deref());
    if let Some((instance, over)) = each.filter(|(_, over)| Some(*over) == list) {
        let mut same = of_family().filter(|(_, n)| n.instance.as_deref() == Some(instance));
        let (node, _) =
            same.next().ok_or_else(|| Error::new(format!("`{source}` has no instance for each `{over}`")))?;
        return Ok(vec![Link { instance: None, node }]);
    }
    let all: Vec<Link> = of_family().map(|(node, n)| Link { instance: n.instance.clone(), node }).collect();
    if all.is_empty() {
        let names: Vec<&str> = nodes.iter().map(|n| n.name.as_str()).collect();
        return Err(Error::new(format!("input `{source}` is no stage of the pipeline")).hint(known(&names, source)));
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::{Graph, toy};

    fn graph(text: &str) -> Result<Graph> {
        let manifest = toml::from_str("[records]\ncomponents = ['EW', 'NS']\nempty = []").expect("the text is TOML");
        Graph::new(&Recipe::parse(text, "p.toml")?, toy::STAGES, &manifest)
    }

    fn message(text: &str) -> String {
        let error = graph(text).err().expect("a mistake");
        assert_eq!(error.exit_status(), 2);
        error.to_string()
    }

    #[test]
    fn each_makes_instances_and_a_reader_gets_all_or_its_own() {
        let graph = graph(
            "about = 'x'\n[[stage]]\nname = 'all'\nkind = 'join'\ninputs = { in = 'fit', one = 'fit.NS' }\n\
             [[stage]]\nname = 'fit'\nkind = 'join'\neach = 'records.components'\ninputs = { in = 'a' }\n\
             [[stage]]\nname = 'next'\nkind = 'join'\neach = 'records.components'\ninputs = { in = 'fit' }\npublish = false\n\
             [[stage]]\nname = 'a'\nkind = 'number'\n",
        )
        .expect("sound");
        let names: Vec<&str> = graph.nodes().iter().map(|n| n.name.as_str()).collect();
        assert_eq!(names, ["a", "fit.EW", "fit.NS", "all", "next.EW", "next.NS"]);
        let all = &graph.nodes()[3];
        let instances: Vec<_> = all.inputs["in"].iter().map(|l| (l.instance.as_deref(), l.node)).collect();
        assert_eq!(instances, [(Some("EW"), 1), (Some("NS"), 2)]);
        assert_eq!(all.inputs["one"], [Link { instance: None, node: 2 }]);
        assert_eq!(graph.nodes()[5].inputs["in"], [Link { instance: None, node: 2 }]);
        assert_eq!(graph.select("fit").expect("known"), BTreeSet::from([1, 2]));
        assert_eq!(graph.downstream(&BTreeSet::from([1])), BTreeSet::from([1, 3, 4]));
        assert_eq!(graph.upstream(&BTreeSet::from([4])), BTreeSet::from([0, 1, 4]));
        assert!(graph.mermaid().contains("n0 --> n1") && graph.dot().contains("n0 -> n1"));
    }

    #[test]
    fn instances_publish_beside_each_other() {
        assert_eq!(published_name("metrics.json", None), "metrics.json");
        assert_eq!(published_name("site.corrected.toml", Some("EW")), "site.corrected.EW.toml");
        assert_eq!(published_name("log", Some("EW")), "log.EW");
    }

    #[test]
    fn mistakes_name_the_place_and_the_remedy() {
        let unknown = message("about = 'x'\n[[stage]]\nname = 'a'\nkind = 'numbr'\n");
        assert!(unknown.starts_with("unknown stage kind `numbr`\n  in stage `a`\n  in pipeline `p.toml`"), "{unknown}");
        assert!(unknown.contains("nearest: `number`"), "{unknown}");
        let input = message("about = 'x'\n[[stage]]\nname = 'one'\nkind = 'join'\ninputs = { in = 'tow' }\n");
        assert!(input.starts_with("input `tow` is no stage of the pipeline\n  in stage `one`"), "{input}");
        let instance = message(
            "about = 'x'\n[[stage]]\nname = 'number'\n[[stage]]\nname = 'one'\nkind = 'join'\ninputs = { in = 'number.NS' }\n",
        );
        assert!(instance.starts_with("input `number.NS` is no stage"), "{instance}");
        let twice = message("about = 'x'\n[[stage]]\nname = 'number'\n[[stage]]\nname = 'number'\n");
        assert!(twice.starts_with("two stages are named `number`"), "{twice}");
        let circle = message(
            "about = 'x'\n[[stage]]\nname = 'a'\nkind = 'join'\ninputs = { in = 'b' }\n\
             [[stage]]\nname = 'b'\nkind = 'join'\ninputs = { in = 'a' }\n",
        );
        assert!(circle.starts_with("stages wait for each other in a circle: `a`, `b`"), "{circle}");
        let itself = message("about = 'x'\n[[stage]]\nname = 'a'\nkind = 'join'\ninputs = { in = 'a' }\n");
        assert!(itself.starts_with("stages wait for each other in a circle: `a`"), "{itself}");
        for list in ["records.empty", "records.absent"] {
            let each = message(&format!("about = 'x'\n[[stage]]\nname = 'number'\neach = '{list}'\n"));
            assert!(each.contains("must name a list of texts"), "{each}");
        }
        let clash =
            message("about = 'x'\n[[stage]]\nname = 'a'\nkind = 'join'\n[[stage]]\nname = 'b'\nkind = 'join'\n");
        assert!(clash.starts_with("`value.txt` is published by `a` already\n  in stage `b`"), "{clash}");
        assert!(message("about = 'x'\n[[stage]]\nname = 'a.b'\nkind = 'number'\n").contains("must be letters"));
    }
}
