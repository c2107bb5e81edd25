//! Which source file knows which other, and whether any two of them know each other.

use std::collections::{BTreeMap, BTreeSet};

/// A module: the names from the crate's root to it.
type Module = Vec<String>;

/// The files of a crate, each as a module, and the modules that each of them names.
pub struct Crate {
    files: BTreeMap<Module, File>,
}

/// Files or folders of which each can be reached from each other one.
pub struct Circle {
    /// All of them.
    pub members: BTreeSet<String>,
    /// The shortest way from the first of them back to it: `a → b → a`.
    pub way: String,
}

/// What matters of a source file.
#[derive(Default)]
struct File {
    /// Names that it imports or re-exports, each with its path.
    exports: BTreeMap<String, Vec<String>>,
    /// All other paths in it.
    paths: Vec<Vec<String>>,
}

impl Crate {
    /// The crate of these sources: paths below its `src`, and texts.
    pub fn new(sources: &[(String, String)]) -> Self {
        let of_file = |(path, text): &(String, String)| (module(path), File::new(&code(text)));
        Self { files: sources.iter().map(of_file).collect() }
    }

    /// Circles between files.
    pub fn circles_of_files(&self) -> Vec<Circle> {
        circles(&self.graph(|module| module.join("/")))
    }

    /// Circles between the folders and files at the top of the crate.
    pub fn circles_of_folders(&self) -> Vec<Circle> {
        circles(&self.graph(|module| module.first().cloned().unwrap_or_default()))
    }

    /// For each node, the nodes that it names, where `node` gives the node of a module.
    fn graph(&self, node: impl Fn(&Module) -> String) -> BTreeMap<String, BTreeSet<String>> {
        let mut graph: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (from, file) in &self.files {
            let named = file.paths.iter().filter_map(|path| self.resolve(from, path)).map(|to| node(&to));
            let own = node(from);
            let named: Vec<String> = named.filter(|to| *to != own).collect();
            graph.entry(own).or_default().extend(named);
        }
        graph
    }

    /// The file in which a path ends that is written in the module `from`; `None` if it leaves the crate.
    fn resolve(&self, from: &Module, path: &[String]) -> Option<Module> {
        let mut place = from.clone();
        let mut rest = path;
        match rest.first()?.as_str() {
            "crate" => {
                place.clear();
                rest = &rest[1..];
            }
            "self" => rest = &rest[1..],
            "super" => {
                while rest.first().is_some_and(|name| name == "super") {
                    place.pop()?;
                    rest = &rest[1..];
                }
            }
            name if self.files.contains_key(&[from.as_slice(), &[name.to_string()]].concat()) => {}
            _ => return None,
        }
        while let Some((name, after)) = rest.split_first() {
            let inner = [place.as_slice(), std::slice::from_ref(name)].concat();
            if self.files.contains_key(&inner) {
                (place, rest) = (inner, after);
                continue;
            }
            return match self.files.get(&place).and_then(|file| file.exports.get(name)) {
                Some(exported) if exported != path => self.resolve(&place, exported),
                _ => Some(place),
            };
        }
        Some(place)
    }
}

impl File {
    fn new(code: &str) -> Self {
        let mut file = Self::default();
        let mut rest = String::new();
        for (number, statement) in code.split(';').enumerate() {
            let Some(at) = find_use(statement) else {
                rest += if number == 0 { "" } else { ";" };
                rest += statement;
                continue;
            };
            let (before, tree) = statement.split_at(at);
            rest += before;
            let tree = tree.trim_start_matches("use").trim();
            let exported = before.trim_end().ends_with("pub") || before.trim_end().ends_with("pub(crate)");
            for path in expand(tree) {
                // What a file imports, the files below it may take from it.
                file.exports.insert(path.last().cloned().unwrap_or_default(), path.clone());
                if !exported {
                    file.paths.push(path);
                }
            }
        }
        file.paths.extend(inline_paths(&rest));
        file
    }
}

/// Where the word `use` begins the statement or follows its visibility.
fn find_use(statement: &str) -> Option<usize> {
    let at = statement.rfind("use ")?;
    let before = statement[..at].trim_end();
    let begins = before.is_empty() || before.ends_with(['}', '{', ']']) || before.ends_with("pub");
    (begins || before.ends_with("pub(crate)") || before.ends_with("pub(super)")).then_some(at)
}

/// All paths of a tree such as `a::{b, c::{self, d as e}}`.
fn expand(tree: &str) -> Vec<Vec<String>> {
    let tree = tree.trim();
    let Some((head, group)) = tree.split_once('{') else {
        let path = tree.split(" as ").next().unwrap_or_default();
        return vec![path.split("::").map(|name| name.trim().to_string()).filter(|name| !name.is_empty()).collect()];
    };
    let head: Vec<String> = head.split("::").map(|name| name.trim().to_string()).filter(|it| !it.is_empty()).collect();
    let group = group.rsplit_once('}').map_or(group, |(inner, _)| inner);
    let (mut depth, mut parts) = (0, vec![String::new()]);
    for character in group.chars() {
        depth += i32::from(character == '{') - i32::from(character == '}');
        match character {
            ',' if depth == 0 => parts.push(String::new()),
            _ => parts.last_mut().expect("there is always one").push(character),
        }
    }
    let paths = parts.iter().filter(|part| !part.trim().is_empty()).flat_map(|part| expand(part));
    let with_head = |mut path: Vec<String>| {
        if path == ["self"] {
            path.clear();
        }
        [head.clone(), path].concat()
    };
    paths.map(with_head).collect()
}

/// The paths outside of `use`: words joined by `::`.
fn inline_paths(code: &str) -> Vec<Vec<String>> {
    let is_word = |character: char| character.is_alphanumeric() || character == '_' || character == ':';
    let words = code.split(|character: char| !is_word(character)).filter(|word| word.contains("::"));
    words.map(|word| word.split("::").filter(|name| !name.is_empty()).map(str::to_string).collect()).collect()
}

/// The module of a file.
fn module(path: &str) -> Module {
    let mut names: Module = path.trim_end_matches(".rs").split('/').map(str::to_string).collect();
    if names.last().is_some_and(|name| name == "mod" || name == "lib") {
        names.pop();
    }
    names
}

/// A source without comments, texts and the unit tests at its end.
fn code(text: &str) -> String {
    let text = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    let text = text.split("#[cfg(test)]\n#[path").next().unwrap_or_default();
    let mut code = String::new();
    for line in text.lines() {
        let mut quoted = false;
        let mut before = ' ';
        for (at, character) in line.char_indices() {
            if !quoted && line[at..].starts_with("//") {
                break;
            }
            if character == '"' && before != '\\' && before != '\'' {
                quoted = !quoted;
            } else if !quoted {
                code.push(character);
            }
            before = if before == '\\' { ' ' } else { character };
        }
        code.push('\n');
    }
    code
}

/// One circle for each set of nodes that can all be reached from each other, by Tarjan's algorithm.
fn circles(graph: &BTreeMap<String, BTreeSet<String>>) -> Vec<Circle> {
    let mut search = Search::new(graph);
    graph.keys().for_each(|node| search.visit(node));
    let circle = |component: &BTreeSet<&str>| Circle {
        members: component.iter().map(|node| node.to_string()).collect(),
        way: shortest(graph, component),
    };
    search.components.iter().map(circle).collect()
}

/// Tarjan's depth-first search (1972, SIAM J. Comput. 1, 146).
struct Search<'a> {
    graph: &'a BTreeMap<String, BTreeSet<String>>,
    index: BTreeMap<&'a str, usize>,
    low: BTreeMap<&'a str, usize>,
    stack: Vec<&'a str>,
    components: Vec<BTreeSet<&'a str>>,
}

impl<'a> Search<'a> {
    fn new(graph: &'a BTreeMap<String, BTreeSet<String>>) -> Self {
        Self { graph, index: BTreeMap::new(), low: BTreeMap::new(), stack: Vec::new(), components: Vec::new() }
    }

    fn visit(&mut self, node: &'a str) {
        if self.index.contains_key(node) {
            return;
        }
        let number = self.index.len();
        self.index.insert(node, number);
        self.low.insert(node, number);
        self.stack.push(node);
        for next in self.graph.get(node).into_iter().flatten() {
            let known = self.index.get(next.as_str()).copied();
            self.visit(next);
            let reached = match known {
                None => self.low[next.as_str()],
                Some(index) if self.stack.contains(&next.as_str()) => index,
                Some(_) => continue,
            };
            let low = self.low[node].min(reached);
            self.low.insert(node, low);
        }
        if self.low[node] == number {
            let at = self.stack.iter().position(|it| *it == node).expect("it was pushed");
            let component: BTreeSet<&str> = self.stack.split_off(at).into_iter().collect();
            if component.len() > 1 {
                self.components.push(component);
            }
        }
    }
}

/// The shortest way from the first node of a component back to it.
fn shortest(graph: &BTreeMap<String, BTreeSet<String>>, component: &BTreeSet<&str>) -> String {
    let start = *component.first().expect("it has several nodes");
    let mut ways = vec![vec![start]];
    let mut seen = BTreeSet::new();
    loop {
        let mut longer = Vec::new();
        for way in &ways {
            let last = *way.last().expect("a way has a start");
            for next in graph[last].iter().map(String::as_str).filter(|next| component.contains(next)) {
                let way = [way.as_slice(), &[next]].concat();
                if next == start {
                    return way.join(" → ");
                }
                if seen.insert(next) {
                    longer.push(way);
                }
            }
        }
        ways = longer;
    }
}

fn of(sources: &[(&str, &str)]) -> Crate {
    let owned = |(path, text): &(&str, &str)| (path.to_string(), text.to_string());
    Crate::new(&sources.iter().map(owned).collect::<Vec<_>>())
}

/// The ways of circles.
fn ways(circles: Vec<Circle>) -> Vec<String> {
    circles.into_iter().map(|circle| circle.way).collect()
}

#[test]
fn files_that_know_each_other_are_found() {
    let pair = of(&[("lib.rs", "mod a;\nmod b;"), ("a.rs", "use crate::b::B;"), ("b.rs", "fn f() -> crate::a::A {}")]);
    assert_eq!(ways(pair.circles_of_files()), ["a → b → a"]);
    let through_groups = of(&[
        ("a.rs", "use super::{c, b::{self, B as Other}};"),
        ("b.rs", "use std::fmt;\nuse crate::c::C;"),
        ("c.rs", "use crate::{d, a::A};"),
        ("d.rs", ""),
    ]);
    assert_eq!(ways(through_groups.circles_of_files()), ["a → c → a"]);
    let members: Vec<String> = through_groups.circles_of_files()[0].members.iter().cloned().collect();
    assert_eq!(members, ["a", "b", "c"]);
    let parent = of(&[("m/mod.rs", "mod child;\nuse child::help;\npub struct M;"), ("m/child.rs", "use super::M;")]);
    assert_eq!(ways(parent.circles_of_files()), ["m → m/child → m"]);
    assert!(parent.circles_of_folders().is_empty());
}

#[test]
fn folders_that_know_each_other_are_found_where_no_two_files_do() {
    let folders = of(&[
        ("x/mod.rs", "mod one;\npub mod three;"),
        ("x/one.rs", "use crate::y::two::T;"),
        ("x/three.rs", ""),
        ("y/mod.rs", "mod four;\npub mod two;"),
        ("y/two.rs", ""),
        ("y/four.rs", "use crate::x::three;"),
    ]);
    assert!(folders.circles_of_files().is_empty());
    assert_eq!(ways(folders.circles_of_folders()), ["x → y → x"]);
}

#[test]
fn comments_texts_tests_and_re_exports_make_no_circle() {
    let innocent = of(&[
        ("lib.rs", "pub mod a;\npub mod m;\npub use a::A;"),
        (
            "a.rs",
            "// use crate::m::Q;\nfn f() { print(\"crate::m::Q\") } // crate::m::Q\n#[cfg(test)]\nmod tests { use crate::m::Q; }",
        ),
        ("m/mod.rs", "mod inner;\nmod other;\npub use inner::{Inner, Q};\nuse crate::a::A;"),
        ("m/inner.rs", "use crate::A;"),
        ("m/other.rs", "use super::Inner;\nuse std::m::a;"),
    ]);
    assert_eq!(ways(innocent.circles_of_files()), Vec::<String>::new());
    // What is re-exported is where it is defined.
    let hidden = of(&[
        ("m/mod.rs", "mod inner;\nmod other;\npub use inner::Inner;"),
        ("m/inner.rs", "use super::other;"),
        ("m/other.rs", "use crate::m::Inner;"),
    ]);
    assert_eq!(ways(hidden.circles_of_files()), ["m/inner → m/other → m/inner"]);
}
