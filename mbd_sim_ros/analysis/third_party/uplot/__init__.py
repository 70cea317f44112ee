"""uPlot 1.6.32, MIT: draws the axes and curves of web pages."""
