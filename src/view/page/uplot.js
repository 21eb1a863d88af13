// Placeholder of uPlot.
