// What PCL does for a cloud.
#pragma once

#include "iris/types/point_cloud.h"

namespace iris::exporters {

// Drops points that stand alone (statistical outliers: the mean distance to `outlier_points` neighbours is more than
// `outlier_sigma` standard deviations above its mean over the cloud; 0 points = none is dropped), then fits a plane to
// each point's `normal_points` nearest neighbours: its normal, turned to the side that `normal` showed before. Points
// with fewer than three neighbours within reach keep that direction.
// Works in tiles, each with what surrounds it, so that PCL's trees stay small however large the cloud is. The same
// result for any number of threads.
void filter_cloud(PointCloud& cloud, int outlier_points, double outlier_sigma, int normal_points);

}  // namespace iris::exporters
