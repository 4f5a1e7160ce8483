"""The parts of the HTML page: pictures, lattice drawings, plots and templates."""
