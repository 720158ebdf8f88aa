//! Writes an imported table as a recording: the CSV of the contract, and its data package that says where it comes from.

use std::io::{self, Write};
use std::path::Path;

use serde_json::json;
use sha2::{Digest, Sha256};

use super::imported::Imported;
use super::mapping::MapTarget;
use crate::recording::datapackage::{self, Resource};
use crate::recording::{atomic_file, csv};

/// Where an imported table comes from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ImportSource<'a> {
    /// Name of the foreign file.
    pub file_name: &'a str,
    /// Content of that file.
    pub bytes: &'a [u8],
    /// Time of the import, UTC, RFC 3339.
    pub imported_utc: &'a str,
}

fn sha256(bytes: &[u8]) -> String {
    let hash = Sha256::digest(bytes);
    hash.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Writes `csv` and its data package, each whole or not at all. Files that are there are replaced.
pub(crate) fn save(imported: &Imported, source: &ImportSource<'_>, csv: &Path) -> io::Result<()> {
    let mut bytes = Vec::new();
    csv::write_recording(&mut bytes, &imported.recording)?;
    let mut columns = csv::NEEDED.to_vec();
    if imported.recording.cycle.is_some() {
        columns.push(MapTarget::Cycle.name());
    }
    let resource = Resource {
        file_name: csv.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        bytes: bytes.len() as u64,
        sha256: sha256(&bytes),
        rows: imported.recording.len() as u64,
        columns,
        selection: "imported table".to_owned(),
    };
    let name = csv.file_stem().unwrap_or_default().to_string_lossy();
    let package = datapackage::of_table(
        &name,
        &format!("{name}, imported from {}", source.file_name),
        source.imported_utc,
        &resource,
        json!({
            "imported_from": { "file": source.file_name, "sha256": sha256(source.bytes), "bytes": source.bytes.len() },
            "imported": imported,
            "map": imported.map_text(),
            "rows": resource.rows,
            "program_version": env!("CARGO_PKG_VERSION"),
            "sign": datapackage::SIGN
        }),
    );
    atomic_file::write(csv, |file| file.write_all(&bytes))?;
    atomic_file::write(&datapackage::path_of(csv), |file| {
        serde_json::to_writer_pretty(&mut *file, &package)?;
        file.write_all(b"\n")
    })
}

#[cfg(test)]
mod tests {
    use super::super::{ImportOptions, import};
    use super::*;

    #[test]
    fn the_recording_reads_back_and_its_package_says_where_it_comes_from() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("logger.csv");
        let bytes = b"Zeit [s];Weg [mm];Kraft [kN]\n0,0;0,5;0,1\n0,1;0,6;0,2\n0,2;0,7;0,3\n";
        let imported = import("f.csv", bytes, &ImportOptions::default()).expect("a table");
        let source = ImportSource {
            file_name: "f.csv",
            bytes,
            imported_utc: "2026-01-01T00:00:00Z",
        };
        save(&imported, &source, &path).expect("written");
        assert_eq!(
            csv::read_file(&path).expect("a recording").force_n,
            [100.0, 200.0, 300.0]
        );
        let text = std::fs::read_to_string(datapackage::path_of(&path)).expect("written");
        let package: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let csv_bytes = std::fs::read(&path).expect("written");
        assert_eq!(
            package["resources"][0]["hash"],
            format!("sha256:{}", sha256(&csv_bytes))
        );
        assert_eq!(package["resources"][0]["schema"]["fields"][2]["unit"], "N");
        assert_eq!(package["leafbench"]["imported_from"]["file"], "f.csv");
        assert_eq!(package["leafbench"]["imported"]["mapped"][2]["factor"], 1000.0);
    }
}
