namespace iris::exporters {}
