//! A plain text table for terminals: columns as wide as they need, numbers to the right.

/// The table with its head underlined.
pub fn render(head: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        rows.iter()
            .filter_map(|r| r.get(column))
            .map(String::as_str)
            .chain(head.get(column).copied())
            .map(|cell| cell.chars().count())
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |cells: &[String]| -> String {
        let padded: Vec<String> = cells
            .iter()
            .zip(&widths)
            .map(|(cell, &w)| {
                let number = cell
                    .chars()
                    .next()
                    .is_some_and(|c| c.is_ascii_digit() || "+-".contains(c));
                if number {
                    format!("{cell:>w$}")
                } else {
                    format!("{cell:<w$}")
                }
            })
            .collect();
        padded.join("  ").trim_end().to_owned()
    };
    let head: Vec<String> = head.iter().map(|h| (*h).to_owned()).collect();
    let rule: Vec<String> = widths.iter().map(|&w| "-".repeat(w)).collect();
    let mut lines = vec![line(&head), rule.join("  ")];
    lines.extend(rows.iter().map(|r| line(r)));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_line_up_and_numbers_stand_right() {
        let text = render(
            &["profile", "peak N"],
            &[
                vec!["static-ramp".into(), "2000.1".into()],
                vec!["sine".into(), "9.5".into()],
            ],
        );
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "profile      peak N");
        assert_eq!(lines[2], "static-ramp  2000.1");
        assert_eq!(lines[3], "sine            9.5");
    }
}
