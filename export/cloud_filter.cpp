#include "export/cloud_filter.h"

// PCL's headers take long to compile: this file alone includes them.
#include <pcl/features/normal_3d.h>
#include <pcl/kdtree/kdtree_flann.h>
#include <pcl/point_types.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>

#include "iris/core/parallel.h"

namespace iris::exporters {
namespace {

using Cloud = pcl::PointCloud<pcl::PointXYZ>;

// A cube of space: the points in it, and those of its surroundings that are their neighbours.
struct Tile {
  std::vector<int> own, all;  // indices into the cloud; all: own first
};

std::vector<Tile> tiles_of(const PointCloud& cloud, double side, double margin) {
  std::map<std::array<int, 3>, Tile> tiles;
  const auto key_of = [&](const Eigen::Vector3d& p) {
    return std::array<int, 3>{static_cast<int>(std::floor(p.x() / side)), static_cast<int>(std::floor(p.y() / side)),
                              static_cast<int>(std::floor(p.z() / side))};
  };
  const int count = static_cast<int>(cloud.points.size());
  for (int i = 0; i < count; ++i) {
    Tile& tile = tiles[key_of(cloud.points[static_cast<size_t>(i)].position.cast<double>())];
    tile.own.push_back(i);
  }
  for (auto& [key, tile] : tiles) tile.all = tile.own;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d p = cloud.points[static_cast<size_t>(i)].position.cast<double>();
    const std::array<int, 3> own = key_of(p);
    const std::array<int, 3> low = key_of(p - Eigen::Vector3d::Constant(margin));
    const std::array<int, 3> high = key_of(p + Eigen::Vector3d::Constant(margin));
    if (low == own && high == own) continue;
    for (int x = low[0]; x <= high[0]; ++x) {
      for (int y = low[1]; y <= high[1]; ++y) {
        for (int z = low[2]; z <= high[2]; ++z) {
          const std::array<int, 3> key{x, y, z};
          if (key == own) continue;
          const auto found = tiles.find(key);
          if (found != tiles.end()) found->second.all.push_back(i);
        }
      }
    }
  }
  std::vector<Tile> result;
  for (auto& [key, tile] : tiles) result.push_back(std::move(tile));
  return result;
}

// Calls visit(index, tree, points, place in the tree's cloud) for each point of the cloud, tiles in parallel.
template <class Visit>
void for_each_point(const PointCloud& cloud, const Visit& visit) {
  // 100 edges: on a surface some ten thousand points. The margin holds the neighbours of any point that has enough of
  // them to matter.
  const std::vector<Tile> tiles = tiles_of(cloud, 100 * cloud.edge, 6 * cloud.edge);
  parallel_chunks(0, static_cast<int>(tiles.size()), 1, [&](int t, int) {
    const Tile& tile = tiles[static_cast<size_t>(t)];
    const auto points = pcl::make_shared<Cloud>();
    for (const int i : tile.all) {
      const Eigen::Vector3f& p = cloud.points[static_cast<size_t>(i)].position;
      points->push_back(pcl::PointXYZ(p.x(), p.y(), p.z()));
    }
    pcl::KdTreeFLANN<pcl::PointXYZ> tree;
    tree.setInputCloud(points);
    for (size_t k = 0; k < tile.own.size(); ++k) visit(tile.own[k], tree, *points, static_cast<int>(k));
  });
}

// The mean of `distances` plus so many of their standard deviations; infinite ones do not count.
double outlier_limit(const std::vector<float>& distances, double sigmas) {
  double sum = 0, squares = 0, count = 0;
  for (const float distance : distances) {
    if (!std::isfinite(distance)) continue;
    sum += distance;
    squares += double{distance} * distance;
    ++count;
  }
  if (count == 0) return 0;
  const double mean = sum / count;
  return mean + sigmas * std::sqrt(std::max(0.0, squares / count - mean * mean));
}

}  // namespace

void filter_cloud(PointCloud& cloud, int outlier_points, double outlier_sigma, int normal_points) {
  const int wanted = std::max(outlier_points + 1, normal_points);  // a point is its own nearest
  std::vector<float> distances(cloud.points.size());
  std::vector<Eigen::Vector3f> normals(cloud.points.size());
  for_each_point(cloud, [&](int index, const pcl::KdTreeFLANN<pcl::PointXYZ>& tree, const Cloud& points, int place) {
    pcl::Indices indices;
    std::vector<float> squares;
    const int found = tree.nearestKSearch(points, place, wanted, indices, squares);
    double sum = 0;
    for (int i = 0; i < std::min(found, outlier_points + 1); ++i) sum += std::sqrt(squares[static_cast<size_t>(i)]);
    // Where there are not even so many points around, each stands alone.
    distances[static_cast<size_t>(index)] =
        found > outlier_points ? static_cast<float>(sum / outlier_points) : std::numeric_limits<float>::infinity();
    Eigen::Vector3f& normal = normals[static_cast<size_t>(index)];
    normal = cloud.points[static_cast<size_t>(index)].normal;
    indices.resize(static_cast<size_t>(std::min(found, normal_points)));
    Eigen::Vector4f plane;
    float curvature = 0;
    if (!pcl::computePointNormal(points, indices, plane, curvature) || !plane.allFinite()) return;
    const Eigen::Vector3f fitted = plane.head<3>().normalized();
    if (fitted.allFinite()) normal = fitted.dot(normal) < 0 ? -fitted : fitted;
  });
  const double limit = outlier_limit(distances, outlier_sigma);
  size_t kept = 0;
  for (size_t i = 0; i < distances.size(); ++i) {
    if (outlier_points > 0 && !(distances[i] <= limit)) continue;
    cloud.points[kept] = cloud.points[i];
    cloud.points[kept++].normal = normals[i];
  }
  cloud.points.resize(kept);
}

}  // namespace iris::exporters
