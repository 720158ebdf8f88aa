//! A recording as columns. numpy and Arrow read the memory of the recording itself; it is never written, and each reader keeps the
//! recording alive.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::ffi::{FFI_ArrowArray, FFI_ArrowSchema, to_ffi};
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::{
    Array, ArrayRef, Float64Array, RecordBatch, RecordBatchIterator, UInt16Array, UInt32Array,
};
use arrow_buffer::{Buffer, NullBuffer, ScalarBuffer, ToByteSlice};
use arrow_schema::{ArrowError, DataType, Field, Schema};
use leafbench::{Mode, Recording};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyDict, PyTuple};

use crate::errors;

/// The numbers of one column.
enum Numbers<'a> {
    F64(&'a [f64]),
    U32(&'a [u32]),
    U16(&'a [u16]),
}

impl Numbers<'_> {
    fn bytes(&self) -> &[u8] {
        match self {
            Numbers::F64(values) => values.to_byte_slice(),
            Numbers::U32(values) => values.to_byte_slice(),
            Numbers::U16(values) => values.to_byte_slice(),
        }
    }

    fn len(&self) -> usize {
        match self {
            Numbers::F64(values) => values.len(),
            Numbers::U32(values) => values.len(),
            Numbers::U16(values) => values.len(),
        }
    }

    /// Type for numpy, little endian: the only order of the computers that leafbench is built for.
    fn numpy_type(&self) -> &'static str {
        match self {
            Numbers::F64(_) => "<f8",
            Numbers::U32(_) => "<u4",
            Numbers::U16(_) => "<u2",
        }
    }
}

/// Names of the columns that may be there, in the order of a recording CSV.
const NAMES: [&str; 7] = [
    "time_s",
    "displacement_mm",
    "force_n",
    "command_mm",
    "command_n",
    "cycle",
    "flags",
];

fn unit(name: &str) -> &'static str {
    match name {
        "time_s" => "s",
        "displacement_mm" | "command_mm" => "mm",
        "force_n" | "command_n" => "N",
        _ => "1",
    }
}

/// The numbers of a column; `None` if the recording does not have it.
fn numbers<'a>(recording: &'a Recording, name: &str) -> Option<Numbers<'a>> {
    let command = |mode| {
        let command = recording.command.as_deref();
        command.filter(|_| recording.command_mode == Some(mode))
    };
    match name {
        "time_s" => Some(Numbers::F64(&recording.time_s)),
        "displacement_mm" => Some(Numbers::F64(&recording.displacement_mm)),
        "force_n" => Some(Numbers::F64(&recording.force_n)),
        "command_mm" => command(Mode::Displacement).map(Numbers::F64),
        "command_n" => command(Mode::Force).map(Numbers::F64),
        "cycle" => recording.cycle.as_deref().map(Numbers::U32),
        "flags" => recording.flags.as_deref().map(Numbers::U16),
        _ => None,
    }
}

/// The columns of a recording. Immutable.
#[pyclass(frozen, module = "leafbench._leafbench")]
pub(crate) struct Columns(pub Arc<Recording>);

#[pymethods]
impl Columns {
    /// A recording from the bytes of its columns; it is checked.
    #[new]
    #[pyo3(signature = (name, time_s, displacement_mm, force_n, command_mm=None, command_n=None, cycle=None, flags=None))]
    #[allow(clippy::too_many_arguments, reason = "one for each column")]
    fn new(
        py: Python<'_>,
        name: String,
        time_s: &[u8],
        displacement_mm: &[u8],
        force_n: &[u8],
        command_mm: Option<&[u8]>,
        command_n: Option<&[u8]>,
        cycle: Option<&[u8]>,
        flags: Option<&[u8]>,
    ) -> PyResult<Columns> {
        let command_mode = match (command_mm, command_n) {
            (Some(_), _) => Some(Mode::Displacement),
            (None, Some(_)) => Some(Mode::Force),
            (None, None) => None,
        };
        let recording = Recording {
            name,
            time_s: values(time_s, f64::from_ne_bytes),
            displacement_mm: values(displacement_mm, f64::from_ne_bytes),
            force_n: values(force_n, f64::from_ne_bytes),
            command: command_mm
                .or(command_n)
                .map(|bytes| values(bytes, f64::from_ne_bytes)),
            command_mode,
            cycle: cycle.map(|bytes| values(bytes, u32::from_ne_bytes)),
            flags: flags.map(|bytes| values(bytes, u16::from_ne_bytes)),
        };
        recording.check().map_err(|error| errors::of_columns(py, error))?;
        Ok(Columns(Arc::new(recording)))
    }

    /// File name or run id.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    /// Names of the columns that are there.
    fn names(&self) -> Vec<&'static str> {
        let there = |name: &&str| numbers(&self.0, name).is_some();
        NAMES.into_iter().filter(there).collect()
    }

    fn __getitem__(&self, name: &str) -> PyResult<Column> {
        let column = NAMES.into_iter().find(|known| *known == name);
        let column = column.filter(|name| numbers(&self.0, name).is_some());
        match column {
            Some(name) => Ok(Column {
                recording: Arc::clone(&self.0),
                name,
            }),
            None => Err(PyKeyError::new_err(format!(
                "{} has no column \"{name}\": use one of {}",
                self.0.name,
                self.names().join(", ")
            ))),
        }
    }

    /// A copy with the sign of these channels turned.
    fn flipped(&self, force: bool, displacement: bool) -> Columns {
        let mut recording = Recording::clone(&self.0);
        let turn = |values: &mut Vec<f64>| values.iter_mut().for_each(|value| *value = -*value);
        if force {
            turn(&mut recording.force_n);
        }
        if displacement {
            turn(&mut recording.displacement_mm);
        }
        Columns(Arc::new(recording))
    }

    /// All columns as one batch of an Arrow stream (Arrow PyCapsule interface).
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        // Casting is left to the reader, as the interface allows.
        drop(requested_schema);
        let batch = batch(&self.0).map_err(arrow_error)?;
        let schema = batch.schema();
        let reader = RecordBatchIterator::new([Ok(batch)], schema);
        let stream = FFI_ArrowArrayStream::new(Box::new(reader));
        PyCapsule::new_with_value(py, stream, c"arrow_array_stream")
    }

    /// The schema of the stream (Arrow PyCapsule interface).
    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        let batch = batch(&self.0).map_err(arrow_error)?;
        let schema = FFI_ArrowSchema::try_from(batch.schema().as_ref()).map_err(arrow_error)?;
        PyCapsule::new_with_value(py, schema, c"arrow_schema")
    }
}

/// One column of a recording. numpy and Arrow read it without a copy.
#[pyclass(frozen, module = "leafbench._leafbench")]
pub(crate) struct Column {
    recording: Arc<Recording>,
    name: &'static str,
}

impl Column {
    fn numbers(&self) -> Numbers<'_> {
        // Columns::__getitem__ makes only columns that are there.
        numbers(&self.recording, self.name).unwrap_or(Numbers::F64(&[]))
    }
}

#[pymethods]
impl Column {
    fn __len__(&self) -> usize {
        self.numbers().len()
    }

    /// Place and type of the numbers in memory (array interface of numpy, version 3); read-only.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let numbers = self.numbers();
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("shape", (numbers.len(),))?;
        interface.set_item("typestr", numbers.numpy_type())?;
        interface.set_item("data", (numbers.bytes().as_ptr().addr(), true))?;
        Ok(interface)
    }

    /// The column as an Arrow array (Arrow PyCapsule interface).
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_array__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyTuple>> {
        drop(requested_schema);
        let array = array(&self.recording, self.name);
        let (array, schema): (FFI_ArrowArray, FFI_ArrowSchema) =
            to_ffi(&array.to_data()).map_err(arrow_error)?;
        let schema = PyCapsule::new_with_value(py, schema, c"arrow_schema")?;
        let array = PyCapsule::new_with_value(py, array, c"arrow_array")?;
        PyTuple::new(py, [schema, array])
    }
}

/// What keeps the memory of a column alive while Arrow reads it.
struct Shared {
    recording: Arc<Recording>,
    name: &'static str,
}

impl AsRef<[u8]> for Shared {
    fn as_ref(&self) -> &[u8] {
        match numbers(&self.recording, self.name) {
            Some(Numbers::F64(values)) => values.to_byte_slice(),
            Some(Numbers::U32(values)) => values.to_byte_slice(),
            Some(Numbers::U16(values)) => values.to_byte_slice(),
            None => &[],
        }
    }
}

/// The column as an Arrow array over the memory of the recording. Rows without a command are null.
fn array(recording: &Arc<Recording>, name: &'static str) -> ArrayRef {
    let buffer = Buffer::from(bytes::Bytes::from_owner(Shared {
        recording: Arc::clone(recording),
        name,
    }));
    match numbers(recording, name) {
        Some(Numbers::U32(_)) => Arc::new(UInt32Array::new(ScalarBuffer::from(buffer), None)),
        Some(Numbers::U16(_)) => Arc::new(UInt16Array::new(ScalarBuffer::from(buffer), None)),
        Some(Numbers::F64(values)) if name.starts_with("command") => {
            let there: NullBuffer = values.iter().map(|value| !value.is_nan()).collect();
            let nulls = (there.null_count() > 0).then_some(there);
            Arc::new(Float64Array::new(ScalarBuffer::from(buffer), nulls))
        }
        _ => Arc::new(Float64Array::new(ScalarBuffer::from(buffer), None)),
    }
}

fn batch(recording: &Arc<Recording>) -> Result<RecordBatch, ArrowError> {
    let there = NAMES
        .into_iter()
        .filter(|name| numbers(recording, name).is_some());
    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = there
        .map(|name| {
            let array = array(recording, name);
            let unit = HashMap::from([("unit".to_owned(), unit(name).to_owned())]);
            let nullable = name.starts_with("command");
            let kind: DataType = array.data_type().clone();
            (Field::new(name, kind, nullable).with_metadata(unit), array)
        })
        .unzip();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays)
}

/// Numbers from their bytes; what is left over is ignored.
fn values<const SIZE: usize, T>(bytes: &[u8], number: fn([u8; SIZE]) -> T) -> Vec<T> {
    let (chunks, _) = bytes.as_chunks::<SIZE>();
    chunks.iter().map(|chunk| number(*chunk)).collect()
}

fn arrow_error(error: ArrowError) -> PyErr {
    PyValueError::new_err(format!("the recording cannot be handed to Arrow: {error}"))
}
