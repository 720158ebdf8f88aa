//! A table as the bytes of a Parquet file. Numbers of the samples are decimals: every program reads `force_n` as N, sums are exact, and
//! the difference from row to row takes few bits.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::builder::{
    Decimal128Builder, Float64Builder, Int64Builder, StringBuilder, TimestampMicrosecondBuilder,
};
use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{DataType, Field, Schema, SchemaRef, TimeUnit};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_writer::ArrowWriterOptions;
use parquet::basic::{Compression, Encoding};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::schema::types::ColumnPath;

use super::{ArchiveError, SCHEMA_VERSION};

/// Digits of a decimal: what 64 bits hold.
const PRECISION: u8 = 18;
/// Rows that are collected before they are passed to the writer.
const BATCH_ROWS: usize = 1 << 16;

/// Type of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ColumnForm {
    /// A decimal with so many digits behind the point, stored as differences from row to row.
    Decimal(u8),
    /// A whole number, stored as differences.
    Whole,
    /// A number of 64 bits.
    Number,
    /// Text, each value stored once.
    Text,
    /// A time, UTC.
    Time,
}

/// A column of a table.
#[derive(Debug, Clone, Copy)]
pub(super) struct TableColumn {
    pub name: &'static str,
    pub form: ColumnForm,
    /// The unit; `1` for a pure number, empty for text.
    pub unit: &'static str,
    pub optional: bool,
}

/// A column in which every row has a value.
pub(super) const fn needed(name: &'static str, form: ColumnForm, unit: &'static str) -> TableColumn {
    TableColumn {
        name,
        form,
        unit,
        optional: false,
    }
}

/// A column in which a row may have no value.
pub(super) const fn optional(name: &'static str, form: ColumnForm, unit: &'static str) -> TableColumn {
    TableColumn {
        name,
        form,
        unit,
        optional: true,
    }
}

/// What a row has in one column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum TableValue<'a> {
    /// The digits of a decimal or a whole number; microseconds since 1970 of a time.
    Whole(i64),
    Number(f64),
    Text(&'a str),
    Empty,
}

impl TableValue<'_> {
    /// A number; empty if there is none or if it is not finite.
    pub(super) fn finite(value: Option<f64>) -> Self {
        value
            .filter(|v| v.is_finite())
            .map_or(TableValue::Empty, TableValue::Number)
    }
}

/// A Parquet file in memory that grows row by row.
pub(super) struct ParquetFile {
    writer: ArrowWriter<Vec<u8>>,
    schema: SchemaRef,
    builders: Vec<ColumnBuilder>,
    collected: usize,
    rows: u64,
}

impl ParquetFile {
    /// An empty file. `facts` become its key-value metadata.
    pub(super) fn new(columns: &[TableColumn], facts: &[(&str, &str)]) -> Result<ParquetFile, ArchiveError> {
        let schema = schema(columns);
        let options = ArrowWriterOptions::new()
            .with_properties(properties(columns, facts))
            // The types of Parquet say all; some readers take Arrow's own description for more.
            .with_skip_arrow_metadata(true);
        let writer = ArrowWriter::try_new_with_options(Vec::new(), Arc::clone(&schema), options);
        Ok(ParquetFile {
            writer: writer.map_err(failed("the head of a Parquet file"))?,
            schema,
            builders: columns.iter().map(ColumnBuilder::of).collect(),
            collected: 0,
            rows: 0,
        })
    }

    /// Adds a row with one value for each column.
    pub(super) fn row(&mut self, values: &[TableValue]) -> Result<(), ArchiveError> {
        debug_assert_eq!(values.len(), self.builders.len());
        for (builder, value) in self.builders.iter_mut().zip(values) {
            builder.append(*value);
        }
        self.rows += 1;
        self.collected += 1;
        match self.collected == BATCH_ROWS {
            true => self.write_batch(),
            false => Ok(()),
        }
    }

    /// The bytes of the file and the number of its rows.
    pub(super) fn finish(mut self) -> Result<(Vec<u8>, u64), ArchiveError> {
        self.write_batch()?;
        let bytes = self
            .writer
            .into_inner()
            .map_err(failed("the end of a Parquet file"))?;
        Ok((bytes, self.rows))
    }

    fn write_batch(&mut self) -> Result<(), ArchiveError> {
        self.collected = 0;
        let mut arrays = Vec::with_capacity(self.builders.len());
        for builder in &mut self.builders {
            arrays.push(builder.finish().map_err(failed("a column of a Parquet file"))?);
        }
        let batch = RecordBatch::try_new(Arc::clone(&self.schema), arrays);
        let batch = batch.map_err(|e| failed("rows of a Parquet file")(e.into()))?;
        self.writer
            .write(&batch)
            .map_err(failed("rows of a Parquet file"))
    }
}

fn failed(what: &'static str) -> impl FnOnce(ParquetError) -> ArchiveError {
    move |source| ArchiveError::Parquet {
        what,
        source: Box::new(source),
    }
}

fn schema(columns: &[TableColumn]) -> SchemaRef {
    let field = |column: &TableColumn| {
        let kind = match column.form {
            ColumnForm::Decimal(digits) => DataType::Decimal128(PRECISION, digits.cast_signed()),
            ColumnForm::Whole => DataType::Int64,
            ColumnForm::Number => DataType::Float64,
            ColumnForm::Text => DataType::Utf8,
            ColumnForm::Time => DataType::Timestamp(TimeUnit::Microsecond, Some("UTC".into())),
        };
        let unit = HashMap::from([("unit".to_owned(), column.unit.to_owned())]);
        Field::new(column.name, kind, column.optional).with_metadata(unit)
    };
    Arc::new(Schema::new(columns.iter().map(field).collect::<Vec<_>>()))
}

fn properties(columns: &[TableColumn], facts: &[(&str, &str)]) -> WriterProperties {
    let mut facts: Vec<KeyValue> = facts
        .iter()
        .map(|(key, value)| KeyValue::new((*key).to_owned(), (*value).to_owned()))
        .collect();
    facts.push(KeyValue::new(
        "schema_version".to_owned(),
        SCHEMA_VERSION.to_string(),
    ));
    let units = columns.iter().filter(|c| !c.unit.is_empty());
    facts.extend(units.map(|c| KeyValue::new(format!("unit.{}", c.name), c.unit.to_owned())));
    let mut properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_created_by(format!("leafbench {}", env!("CARGO_PKG_VERSION")))
        .set_key_value_metadata(Some(facts));
    for column in columns {
        if matches!(
            column.form,
            ColumnForm::Decimal(_) | ColumnForm::Whole | ColumnForm::Time
        ) {
            let path = ColumnPath::from(column.name);
            properties = properties
                .set_column_dictionary_enabled(path.clone(), false)
                .set_column_encoding(path, Encoding::DELTA_BINARY_PACKED);
        }
    }
    properties.build()
}

/// Collects the values of one column.
enum ColumnBuilder {
    Decimal(Decimal128Builder, i8),
    Whole(Int64Builder),
    Number(Float64Builder),
    Text(StringBuilder),
    Time(TimestampMicrosecondBuilder),
}

impl ColumnBuilder {
    fn of(column: &TableColumn) -> ColumnBuilder {
        match column.form {
            ColumnForm::Decimal(digits) => {
                ColumnBuilder::Decimal(Decimal128Builder::new(), digits.cast_signed())
            }
            ColumnForm::Whole => ColumnBuilder::Whole(Int64Builder::new()),
            ColumnForm::Number => ColumnBuilder::Number(Float64Builder::new()),
            ColumnForm::Text => ColumnBuilder::Text(StringBuilder::new()),
            ColumnForm::Time => ColumnBuilder::Time(TimestampMicrosecondBuilder::new()),
        }
    }

    /// A value of another type becomes an empty one.
    fn append(&mut self, value: TableValue) {
        use TableValue::{Number, Text, Whole};
        match (self, value) {
            (ColumnBuilder::Decimal(builder, _), Whole(digits)) => builder.append_value(i128::from(digits)),
            (ColumnBuilder::Decimal(builder, _), _) => builder.append_null(),
            (ColumnBuilder::Whole(builder), Whole(value)) => builder.append_value(value),
            (ColumnBuilder::Whole(builder), _) => builder.append_null(),
            (ColumnBuilder::Number(builder), Number(value)) => builder.append_value(value),
            (ColumnBuilder::Number(builder), _) => builder.append_null(),
            (ColumnBuilder::Text(builder), Text(text)) => builder.append_value(text),
            (ColumnBuilder::Text(builder), _) => builder.append_null(),
            (ColumnBuilder::Time(builder), Whole(value)) => builder.append_value(value),
            (ColumnBuilder::Time(builder), _) => builder.append_null(),
        }
    }

    fn finish(&mut self) -> Result<ArrayRef, ParquetError> {
        Ok(match self {
            ColumnBuilder::Decimal(builder, digits) => {
                let array = builder.finish().with_precision_and_scale(PRECISION, *digits)?;
                Arc::new(array)
            }
            ColumnBuilder::Whole(builder) => Arc::new(builder.finish()),
            ColumnBuilder::Number(builder) => Arc::new(builder.finish()),
            ColumnBuilder::Text(builder) => Arc::new(builder.finish()),
            ColumnBuilder::Time(builder) => Arc::new(builder.finish().with_timezone("UTC")),
        })
    }
}
