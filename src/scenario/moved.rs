//! The files that a scenario names, and its text in another place.

use super::Scenario;
use crate::place::{beside, seen_from};
use crate::shipped;
use std::path::{Path, PathBuf};
use toml::Value;

impl Scenario {
    /// The files that the scenario names: what it calls them, and their paths.
    pub fn files(&self) -> impl Iterator<Item = (&str, PathBuf)> {
        self.file_names.iter().map(|file| (file.name.as_str(), beside(&self.path, &file.name)))
    }

    /// The scenario's text for a file in another directory: relative names of files are those that lead from there to the
    /// same files.
    pub fn text_in(&self, directory: &Path) -> String {
        let mut text = self.text.clone();
        let moves = |name: &Path| name.is_relative() && !shipped::contains(name);
        for file in self.file_names.iter().rev().filter(|file| moves(Path::new(&file.name))) {
            let path = seen_from(directory, &beside(&self.path, &file.name));
            // A path that is not text cannot stand in a scenario.
            if let Ok(path) = path.into_os_string().into_string() {
                text.replace_range(file.span.clone(), &Value::String(path).to_string());
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    /// Every key that names a file, of every kind.
    #[test]
    fn names_of_files_lead_to_the_same_files() {
        let place = tempfile::tempdir().unwrap();
        let here = place.path();
        let names = ["it's \"here\".csv", "members.csv", "state.csv", "obs.csv", "/no/such.db"];
        fs::create_dir(here.join("data")).unwrap();
        let rows = |row: &str| row.repeat(48);
        fs::write(here.join("data").join(names[0]), "id,x_m,y_m,group\n1,2e5,2e5,A\n2,3e5,2e5,B\n").unwrap();
        fs::write(here.join("data").join(names[1]), rows("1,2\n").replacen('1', "3", 1)).unwrap();
        fs::write(here.join("data").join(names[2]), format!("h,u,v\n{}", rows("1000,0,0\n"))).unwrap();
        fs::write(here.join("data").join(names[3]), "cycle,x_m,y_m,value\n1,3e5,2e5,1000\n").unwrap();
        let text = include_str!("../../tests/common/valid.toml")
            .replace("{ regular = [3, 2] }", "{ file = \"data/it's \\\"here\\\".csv\" }")
            .replace("groups = [\"A\", \"B\"]\n", "group_by = \"group\"\n")
            .replace(
                "kind = \"jet\"\nmean_depth_m = 1000\nspeed_m_per_s = 10\nwidth_km = 200",
                "kind = \"file\"\nfile = \"data/state.csv\"",
            )
            .replace(
                "components = [",
                "components = [{ kind = \"members\", variable = \"h\", file = \"data/members.csv\" }, ",
            )
            .replace(
                "[methods.free]",
                "[networks.buoys]\nkind = \"file\"\nfile = \"data/obs.csv\"\nvariable = \"h\"\nsigma = 5\n\
                 [sensors]\ndatabase = \"/no/such.db\"\n[methods.free]",
            );
        let path = here.join("mine.toml");
        fs::write(&path, &text).unwrap();
        let scenario = Scenario::load(&path).unwrap();
        assert_eq!(scenario.tables.len(), 4, "{:?}", scenario.tables);
        let elsewhere = here.join("out/mine-sweep/setting-0001");
        fs::create_dir_all(&elsewhere).unwrap();
        let moved = elsewhere.join("scenario.toml");
        fs::write(&moved, scenario.text_in(&elsewhere)).unwrap();
        let same = Scenario::load(&moved).unwrap();
        assert!(same.tables.values().eq(scenario.tables.values()), "{:?}", same.tables);
        assert!(same.tables.keys().all(|name| name.starts_with("../../../data/")), "{:?}", same.tables);
        assert!(same.text.contains("\"/no/such.db\""));
    }
}
