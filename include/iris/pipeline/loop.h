// The stage between the path as motions chained it and everything that is made from it: loops are found and closed, the
// path is refined and turned upright.
#pragma once

#include "iris/pipeline/options.h"
#include "iris/pipeline/pipeline.h"

namespace iris::pipeline {

// Needs the stage "frames". With loop.enabled = false the path stays as chained; it is turned upright and gets its
// covariances all the same. The options must outlive the stage.
Stage loop_stage(const Options& options);

}  // namespace iris::pipeline
