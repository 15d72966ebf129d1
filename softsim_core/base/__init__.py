"""What every other package uses: errors, units, values, arrays, names, files, processes."""
