//! A run as Apache Parquet: one row for each sample, units at the columns, facts of the run at the file.

use std::collections::HashMap;
use std::io::{self, Write};
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, UInt16Builder, UInt32Builder};
use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;

use super::table::Table;
use crate::recording::columns::{Cell, Column, ColumnKind};

/// Rows that are collected before they are passed to the writer. It is about 4 MB of memory.
const BATCH_ROWS: usize = 1 << 16;

/// Writes the table; the number of rows. `facts` become the key-value metadata of the file.
pub(super) fn write(
    sink: impl Write + Send,
    table: &Table,
    facts: &[(&'static str, String)],
) -> io::Result<u64> {
    let schema = schema(&table.columns, facts);
    let facts = facts
        .iter()
        .map(|(key, value)| KeyValue::new((*key).to_owned(), value.clone()));
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_created_by(format!("leafbench {}", env!("CARGO_PKG_VERSION")))
        .set_key_value_metadata(Some(facts.collect()))
        .build();
    let mut writer =
        ArrowWriter::try_new(sink, Arc::clone(&schema), Some(properties)).map_err(io::Error::other)?;
    let mut batch: Vec<Builder> = table.columns.iter().map(|column| Builder::of(column)).collect();
    let mut collected = 0;
    let rows = table.for_each(|row| {
        for (builder, cell) in batch.iter_mut().zip(row) {
            builder.append(*cell);
        }
        collected += 1;
        if collected == BATCH_ROWS {
            collected = 0;
            write_batch(&mut writer, &schema, &mut batch)?;
        }
        Ok(())
    })?;
    write_batch(&mut writer, &schema, &mut batch)?;
    writer.close().map_err(io::Error::other)?;
    Ok(rows)
}

/// The facts are here too, because Arrow reads only those of its own schema.
fn schema(columns: &[&Column], facts: &[(&'static str, String)]) -> SchemaRef {
    let field = |column: &&Column| {
        let kind = match column.kind {
            ColumnKind::Number => DataType::Float64,
            ColumnKind::Whole32 => DataType::UInt32,
            ColumnKind::Whole16 => DataType::UInt16,
        };
        let metadata = HashMap::from([
            ("unit".to_owned(), column.unit.to_owned()),
            ("description".to_owned(), column.description.to_owned()),
        ]);
        Field::new(column.name, kind, column.may_be_empty()).with_metadata(metadata)
    };
    let facts: HashMap<String, String> = facts
        .iter()
        .map(|(key, value)| ((*key).to_owned(), value.clone()))
        .collect();
    let fields: Vec<Field> = columns.iter().map(field).collect();
    Arc::new(Schema::new_with_metadata(fields, facts))
}

fn write_batch<W: Write + Send>(
    writer: &mut ArrowWriter<W>,
    schema: &SchemaRef,
    batch: &mut [Builder],
) -> io::Result<()> {
    let arrays = batch.iter_mut().map(Builder::finish).collect();
    let batch = RecordBatch::try_new(Arc::clone(schema), arrays).map_err(io::Error::other)?;
    writer.write(&batch).map_err(io::Error::other)
}

/// Collects the cells of one column.
enum Builder {
    Number(Float64Builder),
    Whole32(UInt32Builder),
    Whole16(UInt16Builder),
}

impl Builder {
    fn of(column: &Column) -> Builder {
        match column.kind {
            ColumnKind::Number => Builder::Number(Float64Builder::with_capacity(BATCH_ROWS)),
            ColumnKind::Whole32 => Builder::Whole32(UInt32Builder::with_capacity(BATCH_ROWS)),
            ColumnKind::Whole16 => Builder::Whole16(UInt16Builder::with_capacity(BATCH_ROWS)),
        }
    }

    /// A cell of another type becomes an empty one.
    fn append(&mut self, cell: Cell) {
        match (self, cell) {
            (Builder::Number(builder), Cell::Number(value)) => builder.append_value(value),
            (Builder::Number(builder), _) => builder.append_null(),
            (Builder::Whole32(builder), Cell::Whole(value)) => builder.append_value(value),
            (Builder::Whole32(builder), _) => builder.append_null(),
            (Builder::Whole16(builder), Cell::Whole(value)) => {
                builder.append_option(u16::try_from(value).ok());
            }
            (Builder::Whole16(builder), _) => builder.append_null(),
        }
    }

    fn finish(&mut self) -> ArrayRef {
        match self {
            Builder::Number(builder) => Arc::new(builder.finish()),
            Builder::Whole32(builder) => Arc::new(builder.finish()),
            Builder::Whole16(builder) => Arc::new(builder.finish()),
        }
    }
}
