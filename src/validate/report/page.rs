//! Common parts of all pages: style, tables, verdicts.

use super::number;
use crate::validate::{Check, Limit, Verdict};

const STYLE: &str = "\
body{font:15px/1.5 system-ui,sans-serif;color:#1c1c1c;margin:0 auto;max-width:1180px;padding:1.5em}
h1{font-size:1.7em;margin:.2em 0}h2{margin-top:2em;border-bottom:2px solid #ddd}h3{margin:2em 0 .3em}
table{border-collapse:collapse;margin:.8em 0}td,th{padding:.2em .8em .2em 0;text-align:left;vertical-align:top}
th{border-bottom:1px solid #999;font-weight:600}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}
.about{max-width:62em;margin:.4em 0}.source,.meta{color:#555;font-size:.92em;max-width:62em}
.v{font-weight:700;padding:.05em .5em;border-radius:.3em;white-space:nowrap}
.pass{background:#d8f0df;color:#0b5a26}.fail{background:#f9d5d0;color:#8c1507}.shown{background:#e8e8e8;color:#444}
figure{margin:1em 0}figcaption{font-weight:600;margin-bottom:.2em}.legend span{margin-right:1.4em;white-space:nowrap}
.row{display:flex;flex-wrap:wrap;gap:1em}.row figure{max-width:570px}svg{max-width:100%;height:auto}details{margin:.3em 0 .8em}
summary{cursor:pointer;color:#225}blockquote{border-left:4px solid #bbb;margin:1em 0;padding:.2em 1em;max-width:62em}
a{color:#0a58a5}code{background:#f2f2f2;padding:0 .25em}";

/// Returns a whole page; `body` is HTML.
pub fn page(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{}</title>\n<style>\n{STYLE}\n</style>\n\
         </head>\n<body>\n{body}</body>\n</html>\n",
        escape(title)
    )
}

/// Escapes a text for HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Returns a verdict as a coloured word.
pub fn verdict(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Pass => "<span class=\"v pass\">pass</span>",
        Verdict::Fail => "<span class=\"v fail\">fail</span>",
        Verdict::Shown => "<span class=\"v shown\">shown</span>",
    }
}

/// Returns the limit in words, `at most 0.02 %`; empty for a number without a limit.
pub fn limit(check: &Check) -> String {
    let text = match check.limit {
        Limit::AtMost(high) => format!("at most {}", number(high)),
        Limit::AtLeast(low) => format!("at least {}", number(low)),
        Limit::Between(low, high) => format!("{} to {}", number(low), number(high)),
        Limit::Open => return String::new(),
    };
    format!("{text} {}", check.unit).trim_end().to_owned()
}

/// Returns the table of a case's numbers.
pub fn checks(checks: &[Check]) -> String {
    let row = |c: &Check| {
        format!(
            "<tr><td>{}</td><td class=\"n\">{} {}</td><td>{}</td><td>{}</td></tr>\n",
            escape(&c.what),
            number(c.value),
            escape(c.unit),
            escape(&limit(c)),
            verdict(c.verdict)
        )
    };
    let rows: String = checks.iter().map(row).collect();
    format!(
        "<table><tr><th>measured</th><th class=\"n\">value</th><th>limit</th><th></th></tr>\n{rows}</table>\n"
    )
}
