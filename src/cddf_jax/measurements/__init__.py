"""The user's measured tables: columns with units, trials, holds, and what looks wrong in them."""
