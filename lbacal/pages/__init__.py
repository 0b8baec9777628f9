"""What results look like: tables for a terminal, figures, and HTML reports; `report` has what all share."""
