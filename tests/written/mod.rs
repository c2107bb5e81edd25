//! netCDF files as others write them.

use netcdf3::{DataSet, FileWriter, Version};
use std::path::Path;

/// The values of a variable.
pub enum Values {
    Double(Vec<f64>),
    Single(Vec<f32>),
    Integers(Vec<i32>),
    /// Bytes of text, of the length of the last dimension.
    Text(Vec<u8>),
}

/// A variable: name, dimensions, attributes of text, values.
pub type Variable<'a> = (&'a str, &'a [&'a str], &'a [(&'a str, &'a str)], Values);

/// Writes a file of these dimensions and variables.
pub fn written(path: &Path, dimensions: &[(&str, usize)], variables: &[Variable<'_>]) {
    let mut data_set = DataSet::new();
    for (name, size) in dimensions {
        data_set.add_fixed_dim(*name, *size).unwrap();
    }
    for (name, dimensions, attributes, values) in variables {
        match values {
            Values::Double(_) => data_set.add_var_f64(name, dimensions),
            Values::Single(_) => data_set.add_var_f32(name, dimensions),
            Values::Integers(_) => data_set.add_var_i32(name, dimensions),
            Values::Text(_) => data_set.add_var_u8(name, dimensions),
        }
        .unwrap();
        for (attribute, value) in *attributes {
            data_set.add_var_attr_string(name, attribute, value).unwrap();
        }
    }
    let _ = std::fs::remove_file(path);
    let mut writer = FileWriter::open(path).unwrap();
    writer.set_def(&data_set, Version::Classic, 0).unwrap();
    for (name, _, _, values) in variables {
        match values {
            Values::Double(values) => writer.write_var_f64(name, values),
            Values::Single(values) => writer.write_var_f32(name, values),
            Values::Integers(values) => writer.write_var_i32(name, values),
            Values::Text(values) => writer.write_var_u8(name, values),
        }
        .unwrap();
    }
    writer.close().unwrap();
}
