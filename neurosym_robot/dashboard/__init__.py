"""A view of people and their forecasts: one web page, live over HTTP or as a file to share."""
