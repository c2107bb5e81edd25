//! The whole reference as a document.

use super::{KeyReference, all, inner, keys, row};
use crate::reader::Form;
use crate::text::capitalised;
use std::fmt::Write;

/// The whole reference, as `scenarios/KEYS.md` holds it.
pub fn markdown() -> String {
    let mut text = String::from(
        "# Keys of a scenario\n\nWritten from the program by `ISOBAR_WRITE=1 cargo test --release -p isobar --test all keys`; \
         `isobar explain methods.letkf` and the like show the same, and `isobar schema` writes it for editors.\n\n\
         ## The whole file\n",
    );
    text.push_str(&rows(keys::ALL.iter().map(|key| row(key.name().into(), *key)).collect()));
    for key in keys::ALL {
        let of_table = inner("", &key.form());
        // Kinds and names have places of their own.
        let header = match key.form() {
            Form::Table(_) | Form::Entries(_) => format!("[{}]", key.name()),
            Form::List(_) => format!("[[{}]]", key.name()),
            _ => continue,
        };
        if !of_table.is_empty() {
            write!(text, "\n### `{header}`\n\n{}.\n", capitalised(key.meaning())).expect("a String takes any text");
            text.push_str(&rows(of_table));
        }
    }
    for reference in all() {
        write!(text, "\n## {}\n\n`kind` of {}.\n", reference.title, reference.place).expect("a String takes any text");
        for kind in reference.kinds {
            write!(text, "\n### `{}`\n\n{}.\n", kind.name, kind.about).expect("a String takes any text");
            text.push_str(&rows(kind.keys));
        }
    }
    text
}

/// Keys as a table.
fn rows(keys: Vec<KeyReference>) -> String {
    let mut text = String::new();
    if !keys.is_empty() {
        text.push_str("\n| key | unit | value | default | meaning |\n|---|---|---|---|---|\n");
    }
    for KeyReference { name, unit, allowed, default, meaning } in keys {
        writeln!(text, "| `{name}` | {unit} | {allowed} | {default} | {meaning} |").expect("a String takes any text");
    }
    text
}
