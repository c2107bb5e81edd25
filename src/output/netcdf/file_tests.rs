//! One test for each trap of the netCDF library that [`super`] avoids.

use super::*;
use netcdf_reader::NcFile;

fn definition() -> Definition {
    let mut definition = Definition::new();
    definition.record_dimension("time");
    definition.dimension("x", 3);
    definition.fixed(Variable::new("x", &["x"]).with("units", "m"), Values::Numbers(vec![1.0, 2.0, 4.0]));
    definition.fixed(Variable::new("level", &[]), Values::Integers(vec![7]));
    definition.texts(Variable::new("label", &[]), "x", ["a", "Åland", ""].into_iter());
    definition.record(Variable::new("time", &[]).with("units", "s"));
    definition.record(Variable::new("h", &["x"]).with("_FillValue", FILL_VALUE));
    definition
}

fn numbers(file: &NcFile, name: &str) -> Vec<f64> {
    file.read_variable::<f64>(name).unwrap().iter().copied().collect()
}

/// An output that counts how often it is written to.
struct Counting(io::Cursor<Vec<u8>>, Rc<RefCell<usize>>);

impl Write for Counting {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        *self.1.borrow_mut() += 1;
        self.0.write(bytes)
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Counting {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.0.seek(position)
    }
}

/// An output with no space left.
struct Full(u64);

impl Write for Full {
    fn write(&mut self, _: &[u8]) -> io::Result<usize> {
        Err(io::Error::new(io::ErrorKind::StorageFull, "no space left"))
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Full {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        if let SeekFrom::Start(position) = position {
            self.0 = position;
        }
        Ok(self.0)
    }
}

#[test]
fn the_file_is_well_formed_after_every_record_and_no_value_is_lost() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.nc");
    let mut file = NetcdfFile::create(&path, definition()).unwrap();
    let (mut times, mut fields) = (Vec::new(), Vec::new());
    for record in 0..5 {
        let (time, field) = (record as f64 * 0.1, [record as f64 / 3.0, f64::MIN_POSITIVE, -0.0]);
        file.append(&[("h", &field), ("time", &[time])]).unwrap();
        times.push(time);
        fields.extend(field);
        let read = NcFile::open(&path).unwrap();
        assert_eq!(read.dimension("time").unwrap().size, record as u64 + 1);
        assert_eq!(numbers(&read, "time"), times);
        let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&numbers(&read, "h")), bits(&fields));
        // The library's own `close` would have destroyed records, had these been left to it.
        assert_eq!(numbers(&read, "x"), [1.0, 2.0, 4.0]);
        assert_eq!(read.read_variable::<i32>("level").unwrap().iter().copied().collect::<Vec<_>>(), [7]);
        assert_eq!(read.read_variable_as_strings("label").unwrap(), ["a", "Åland", ""]);
    }
    assert_eq!(file.records(), 5);
}

#[test]
fn numbers_are_not_written_one_by_one() {
    let mut definition = Definition::new();
    definition.dimension("x", 10_000);
    definition.fixed(Variable::new("x", &["x"]), Values::Numbers(vec![0.5; 10_000]));
    let calls = Rc::new(RefCell::new(0));
    definition.write_start(Counting(io::Cursor::default(), Rc::clone(&calls))).unwrap();
    assert!(*calls.borrow() <= 4, "{} calls for 10 000 numbers", calls.borrow());
}

#[test]
fn a_record_can_be_amended_and_nothing_else_changes() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.nc");
    let mut file = NetcdfFile::create(&path, definition()).unwrap();
    for time in [1.0, 2.0, 3.0] {
        file.append(&[("time", &[time]), ("h", &[FILL_VALUE; 3])]).unwrap();
    }
    file.amend(1, &[("h", &[4.0, 5.0, 6.0])]).unwrap();
    file.append(&[("time", &[4.0]), ("h", &[7.0; 3])]).unwrap();
    file.amend(0, &[("h", &[8.0; 3])]).unwrap();
    let read = NcFile::open(&path).unwrap();
    assert_eq!(numbers(&read, "time"), [1.0, 2.0, 3.0, 4.0]);
    assert_eq!(numbers(&read, "x"), [1.0, 2.0, 4.0]);
    let expected = [[8.0; 3], [4.0, 5.0, 6.0], [FILL_VALUE; 3], [7.0; 3]].concat();
    assert_eq!(numbers(&read, "h"), expected);
    assert!(file.amend(4, &[("h", &[1.0; 3])]).unwrap_err().reason.contains("record 4 of 4"));
    assert!(file.amend(0, &[("h", &[1.0; 2])]).is_err() && file.amend(0, &[("g", &[1.0; 3])]).is_err());
}

#[test]
fn a_record_must_be_complete() {
    let directory = tempfile::tempdir().unwrap();
    let mut file = NetcdfFile::create(&directory.path().join("a.nc"), definition()).unwrap();
    let error = file.append(&[("time", &[1.0])]).unwrap_err();
    assert!(error.reason.contains("0 values of `h`"), "{error}");
    assert!(error.path.ends_with("a.nc"));
    assert!(file.append(&[("time", &[1.0]), ("h", &[1.0])]).is_err(), "too few values");
    assert!(file.append(&[("time", &[1.0]), ("h", &[1.0; 3]), ("g", &[1.0])]).is_err(), "an unknown variable");
    assert_eq!(file.records(), 0);
}

#[test]
fn fixed_variables_must_have_all_their_values() {
    let mut definition = definition();
    definition.fixed(Variable::new("y", &["x"]), Values::Numbers(vec![1.0]));
    assert!(definition.write_start(io::Cursor::new(Vec::new())).is_err());
}

#[test]
fn an_attribute_that_is_not_finite_is_refused() {
    let mut definition = definition();
    definition.record(Variable::new("u", &["x"]).with("_FillValue", f64::NAN));
    let error = definition.write_start(io::Cursor::new(Vec::new())).unwrap_err();
    assert!(error.contains("_FillValue"), "{error}");
}

#[test]
fn a_sole_record_variable_is_laid_out_as_the_format_demands() {
    // Only numbers of 8 bytes can be record variables, so no record needs padding.
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.nc");
    let mut definition = Definition::new();
    definition.record_dimension("time");
    definition.record(Variable::new("time", &[]));
    let mut file = NetcdfFile::create(&path, definition).unwrap();
    for time in [1.0, 2.0, 3.0] {
        file.append(&[("time", &[time])]).unwrap();
    }
    assert_eq!(numbers(&NcFile::open(&path).unwrap(), "time"), [1.0, 2.0, 3.0]);
}

#[test]
fn a_full_disk_is_noticed() {
    let error = definition().write_start(Full(0)).unwrap_err();
    assert!(error.contains("no space left") || error.contains("no storage space"), "{error}");
}

#[test]
fn a_record_costs_no_more_than_its_numbers_however_long_the_header_is() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.nc");
    let mut long = definition();
    long.attribute("scenario", "x".repeat(1_000_003));
    let mut file = NetcdfFile::create(&path, long).unwrap();
    let began = std::time::Instant::now();
    for record in 0..2000 {
        file.append(&[("h", &[record as f64; 3]), ("time", &[0.5])]).unwrap();
    }
    assert!(began.elapsed().as_secs_f64() < 2.0, "{:?} for 2000 records", began.elapsed());
    let read = NcFile::open(&path).unwrap();
    let expected: Vec<f64> = (0..6000).map(|number| f64::from(number / 3)).collect();
    assert_eq!(numbers(&read, "h"), expected);
    assert_eq!(numbers(&read, "x"), [1.0, 2.0, 4.0]);
}
