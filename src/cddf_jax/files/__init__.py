"""Files in and out: tables, cross-sections, robot files, safe writing."""
