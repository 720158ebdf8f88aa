//! The program as a stranger meets it: the binary and the public types, nothing from inside.

use std::process::Command;

#[test]
fn help_lists_the_commands_and_the_exit_codes() {
    let said = Command::new(env!("CARGO_BIN_EXE_leafbench"))
        .arg("--help")
        .output()
        .expect("the program starts");
    let text = String::from_utf8_lossy(&said.stdout);
    assert!(said.status.success());
    assert!(text.contains("diagnose") && text.contains("Exit codes"), "{text}");
}
