//! Calibration of a load cell or an LVDT against a reference instrument: points, polynomial, errors and class. `points` has what was
//! read, `fit` the polynomial, `class` the limits of the standards, `assessment` the errors and the class that they allow, `file`
//! the text of a calibration file. Reading files and asking people is left to `config` and `cli`.

pub(crate) mod assessment;
pub(crate) mod class;
pub(crate) mod file;
pub(crate) mod fit;
pub(crate) mod points;

pub(crate) use file::CalibrationFile;
pub(crate) use points::{CalibratedChannel, CalibrationPoint};
