//! Faults that only show when a scenario is built, with their place in its file.

use super::Scenario;
use crate::reader;
use crate::reader::{ScenarioError, SourceFile};
use crate::text::clean_lines;
use toml::de::{DeArray, DeValue};

impl Scenario {
    /// The fault `message` at the key that `path` leads to, as far as the file has its tables and keys; at the file's
    /// beginning if it has none of them. A number leads to an element of a list of tables.
    pub fn fault(&self, path: &[&str], message: String, label: &str) -> ScenarioError {
        let file = SourceFile::new(&self.path, &self.text);
        let tree = match reader::parse(&file, &self.text) {
            Ok(tree) => tree,
            Err(error) => return error,
        };
        let (mut table, mut span) = (Some(&tree), 0..0);
        let mut list: Option<&DeArray<'_>> = None;
        for &key in path {
            if let Some(element) = list.take().and_then(|list| list.get(key.parse::<usize>().ok()?)) {
                span = element.span();
                table = element.get_ref().as_table();
                continue;
            }
            let Some((name, value)) = table.and_then(|table| table.iter().find(|(name, _)| name.get_ref() == key))
            else {
                break;
            };
            let is_table = matches!(value.get_ref(), DeValue::Table(_));
            span = if is_table { name.span() } else { value.span() };
            (table, list) = match value.get_ref() {
                DeValue::Table(table) => (Some(table), None),
                DeValue::Array(array) => (None, Some(array)),
                _ => (None, None),
            };
        }
        // It may quote what a station file says, and list several faults of it, each on its line.
        file.error(span, clean_lines(&message), label, None)
    }
}
