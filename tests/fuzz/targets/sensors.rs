//! A table of sensors: what is accepted can be written and read again.
#![no_main]

use isobar::sensors::{Records, table};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|text: &[u8]| {
    let Ok(rows) = table::parse(Path::new("sensors.csv"), text) else { return };
    let mut records = Records::default();
    for (_, record) in rows {
        let _ = records.add(record);
    }
    let mut again = Records::default();
    for (_, record) in table::parse(Path::new("again.csv"), table::write(&records).as_bytes()).unwrap() {
        again.add(record).unwrap();
    }
    assert_eq!(again, records);
});
