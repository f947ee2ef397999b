"""The only place that formats or draws: results as tables, figures and reports."""
