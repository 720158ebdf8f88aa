//! A run and its limits as test cases in JUnit XML, which CI servers read.

use crate::recording::xml::escaped;

/// How the test case ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum CaseEnding {
    /// The run completed and all its samples are on the disk.
    Passed,
    /// The run began and did not complete, or samples of it are missing.
    Failed {
        /// One word: `stopped`, `aborted` ...
        kind: String,
        /// Why, in one sentence.
        reason: String,
        /// Everything that is known about the end; several lines.
        text: String,
    },
    /// It could not be judged.
    Skipped {
        /// What is missing for a verdict.
        reason: String,
    },
    /// The run could not be started or followed.
    Error {
        /// Why, and what to do.
        reason: String,
    },
}

/// A run or one of its limits, as a CI server shows it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TestCase {
    /// Name of the profile; for a limit with the limit in words.
    pub name: String,
    /// Recorded time in s; 0 if nothing was recorded.
    pub time_s: f64,
    /// Name and value of what was counted.
    pub properties: Vec<(&'static str, String)>,
    pub ending: CaseEnding,
}

/// The report: one suite with these test cases.
pub(crate) fn xml(cases: &[TestCase]) -> String {
    let count = |is: fn(&CaseEnding) -> bool| cases.iter().filter(|case| is(&case.ending)).count();
    let counts = format!(
        "tests=\"{}\" failures=\"{}\" errors=\"{}\" skipped=\"{}\" time=\"{:.3}\"",
        cases.len(),
        count(|e| matches!(e, CaseEnding::Failed { .. })),
        count(|e| matches!(e, CaseEnding::Error { .. })),
        count(|e| matches!(e, CaseEnding::Skipped { .. })),
        cases.iter().map(|case| case.time_s).sum::<f64>()
    );
    let cases: String = cases.iter().map(case_xml).collect();
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
         <testsuites name=\"leafbench\" {counts}>\n  <testsuite name=\"leafbench\" {counts}>\n{cases}  \
         </testsuite>\n</testsuites>\n"
    )
}

fn case_xml(case: &TestCase) -> String {
    let outcome = match &case.ending {
        CaseEnding::Passed => String::new(),
        CaseEnding::Failed { kind, reason, text } => {
            let head = format!("type=\"{}\" message=\"{}\"", escaped(kind), escaped(reason));
            format!("      <failure {head}>{}</failure>\n", escaped(text))
        }
        CaseEnding::Skipped { reason } => format!("      <skipped message=\"{}\"/>\n", escaped(reason)),
        CaseEnding::Error { reason } => {
            format!("      <error type=\"error\" message=\"{}\"/>\n", escaped(reason))
        }
    };
    let properties: String = case
        .properties
        .iter()
        .map(|(name, value)| {
            format!(
                "        <property name=\"{name}\" value=\"{}\"/>\n",
                escaped(value)
            )
        })
        .collect();
    format!(
        "    <testcase classname=\"leafbench\" name=\"{}\" time=\"{:.3}\">\n      \
         <properties>\n{properties}      </properties>\n{outcome}    </testcase>\n",
        escaped(&case.name),
        case.time_s
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(ending: CaseEnding) -> String {
        xml(&[TestCase {
            name: "sine".to_owned(),
            time_s: 1.5,
            properties: vec![("samples", "1500".to_owned())],
            ending,
        }])
    }

    #[test]
    fn a_completed_run_is_a_passed_case() {
        let wanted = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>
<testsuites name=\"leafbench\" tests=\"1\" failures=\"0\" errors=\"0\" skipped=\"0\" time=\"1.500\">
  <testsuite name=\"leafbench\" tests=\"1\" failures=\"0\" errors=\"0\" skipped=\"0\" time=\"1.500\">
    <testcase classname=\"leafbench\" name=\"sine\" time=\"1.500\">
      <properties>
        <property name=\"samples\" value=\"1500\"/>
      </properties>
    </testcase>
  </testsuite>
</testsuites>
";
        assert_eq!(case(CaseEnding::Passed), wanted);
    }

    #[test]
    fn each_case_is_counted_by_its_ending() {
        let limit = |ending| TestCase {
            name: "sine: peak force at most 9 N".to_owned(),
            time_s: 0.0,
            properties: Vec::new(),
            ending,
        };
        let broken = CaseEnding::Failed {
            kind: "limit".to_owned(),
            reason: "12 N".to_owned(),
            text: String::new(),
        };
        let open = CaseEnding::Skipped {
            reason: "no twin".to_owned(),
        };
        let report = xml(&[limit(CaseEnding::Passed), limit(broken), limit(open)]);
        let counts = "tests=\"3\" failures=\"1\" errors=\"0\" skipped=\"1\" time=\"0.000\"";
        assert_eq!(report.matches(counts).count(), 2, "{report}");
        assert_eq!(report.matches("<testcase ").count(), 3, "{report}");
        assert!(report.contains("<skipped message=\"no twin\"/>"), "{report}");
    }

    #[test]
    fn a_failure_has_its_kind_and_reason() {
        let failed = case(CaseEnding::Failed {
            kind: "aborted".to_owned(),
            reason: "force < limit & more".to_owned(),
            text: "run 7 aborted".to_owned(),
        });
        let wanted =
            "<failure type=\"aborted\" message=\"force &lt; limit &amp; more\">run 7 aborted</failure>\n";
        assert!(
            failed.contains(wanted) && failed.contains("failures=\"1\" errors=\"0\""),
            "{failed}"
        );
        let error = case(CaseEnding::Error {
            reason: "no daemon".to_owned(),
        });
        assert!(
            error.contains("<error type=\"error\" message=\"no daemon\"/>")
                && error.contains("failures=\"0\" errors=\"1\""),
            "{error}"
        );
    }
}
