"""The only place that formats or draws."""
