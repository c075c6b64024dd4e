#include "iris/evaluate/cloud.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <unordered_map>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::evaluate {
namespace {

// Squared distance of a point from a triangle: that of its projection if that lies inside, else of the nearest edge.
double squared_distance(const Eigen::Vector3d& p, const std::array<Eigen::Vector3d, 3>& corners) {
  const Eigen::Vector3d normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
  bool inside = normal.squaredNorm() > 0;
  double best = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < 3; ++i) {
    const Eigen::Vector3d &a = corners[i], along = corners[(i + 1) % 3] - a;
    if (normal.cross(along).dot(p - a) < 0) inside = false;
    const double length = along.squaredNorm();
    const double t = length > 0 ? std::clamp((p - a).dot(along) / length, 0.0, 1.0) : 0;
    best = std::min(best, (p - a - t * along).squaredNorm());
  }
  if (!inside) return best;
  const double height = normal.dot(p - corners[0]);
  return height * height / normal.squaredNorm();
}

// The true surface; says how far points are from it.
class Surface {
 public:
  explicit Surface(const std::vector<TriangleMesh>& meshes) {
    for (const TriangleMesh& mesh : meshes) {
      for (const Eigen::Vector3i& t : mesh.triangles) {
        triangles_.push_back({mesh.vertices[static_cast<size_t>(t[0])].cast<double>(),
                              mesh.vertices[static_cast<size_t>(t[1])].cast<double>(),
                              mesh.vertices[static_cast<size_t>(t[2])].cast<double>()});
      }
    }
    device_.reset(rtcNewDevice(nullptr), rtcReleaseDevice);
    scene_.reset(rtcNewScene(device_.get()), rtcReleaseScene);
    const RTCGeometry geometry = rtcNewGeometry(device_.get(), RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                                 3 * sizeof(float), 3 * triangles_.size()));
    auto* indices = static_cast<unsigned*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                                   3 * sizeof(unsigned), triangles_.size()));
    for (size_t i = 0; i < 3 * triangles_.size(); ++i) {
      const Eigen::Vector3f v = triangles_[i / 3][i % 3].cast<float>();
      std::memcpy(vertices + 3 * i, v.data(), 3 * sizeof(float));
      indices[i] = static_cast<unsigned>(i);
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene_.get(), geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene_.get());
    IRIS_CHECK(rtcGetDeviceError(device_.get()) == RTC_ERROR_NONE);
  }

  // [m] Embree finds the triangles that may be the nearest, in float; the distance is exact.
  double distance(const Eigen::Vector3d& point) const {
    Search search{this, point, std::numeric_limits<double>::infinity()};
    RTCPointQuery query;
    query.x = static_cast<float>(point.x());
    query.y = static_cast<float>(point.y());
    query.z = static_cast<float>(point.z());
    query.time = 0;
    query.radius = std::numeric_limits<float>::infinity();
    RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    rtcPointQuery(
        scene_.get(), &query, &context,
        [](RTCPointQueryFunctionArguments* arguments) {
          Search& s = *static_cast<Search*>(arguments->userPtr);
          const double square = squared_distance(s.point, s.surface->triangles_[arguments->primID]);
          if (square >= s.square) return false;
          s.square = square;
          // A little wider than found: the boxes that Embree compares with are rounded.
          arguments->query->radius = static_cast<float>(std::sqrt(square)) * 1.0001f + 1e-6f;
          return true;
        },
        &search);
    return std::sqrt(search.square);
  }

 private:
  struct Search {
    const Surface* surface;
    Eigen::Vector3d point;
    double square;
  };

  std::vector<std::array<Eigen::Vector3d, 3>> triangles_;
  std::shared_ptr<RTCDeviceTy> device_;
  std::shared_ptr<RTCSceneTy> scene_;
};

// Finds points within a fixed reach.
class Neighbourhood {
 public:
  Neighbourhood(const std::vector<Eigen::Vector3d>& points, double reach) : points_(points), reach_(reach) {
    for (size_t i = 0; i < points.size(); ++i) cells_[key_of(points[i], {0, 0, 0})].push_back(static_cast<int>(i));
  }

  bool holds_one_near(const Eigen::Vector3d& point) const {
    for (int x = -1; x <= 1; ++x) {
      for (int y = -1; y <= 1; ++y) {
        for (int z = -1; z <= 1; ++z) {
          const auto found = cells_.find(key_of(point, {x, y, z}));
          if (found == cells_.end()) continue;
          for (const int i : found->second) {
            if ((points_[static_cast<size_t>(i)] - point).squaredNorm() <= reach_ * reach_) return true;
          }
        }
      }
    }
    return false;
  }

 private:
  // 21 bits an axis: two million cells each way. Far cells may share a key, which costs time, never a wrong answer.
  uint64_t key_of(const Eigen::Vector3d& point, const std::array<int, 3>& offset) const {
    uint64_t key = 0;
    for (int i = 0; i < 3; ++i) {
      const auto cell = static_cast<int64_t>(std::floor(point[i] / reach_)) + offset[static_cast<size_t>(i)];
      key = key << 21 | (static_cast<uint64_t>(cell) & 0x1fffff);
    }
    return key;
  }

  const std::vector<Eigen::Vector3d>& points_;
  double reach_;
  std::unordered_map<uint64_t, std::vector<int>> cells_;
};

constexpr int kGrain = 4096;

}  // namespace

CloudErrors evaluate_cloud(const PointCloud& cloud, const Pose& truth_from_cloud,
                           const std::vector<TriangleMesh>& truth, const std::vector<Eigen::Vector3d>& seen,
                           const CloudOptions& options) {
  CloudErrors errors;
  const Surface surface(truth);
  std::vector<Eigen::Vector3d> points;
  for (const CloudPoint& point : cloud.points) points.push_back(truth_from_cloud * point.position.cast<double>());
  std::vector<double> distances(points.size());
  parallel_chunks(0, static_cast<int>(points.size()), kGrain, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      distances[static_cast<size_t>(i)] = surface.distance(points[static_cast<size_t>(i)]);
    }
  });
  std::vector<double> near;
  double within[2] = {}, near_within[2] = {};
  for (size_t i = 0; i < points.size(); ++i) {
    const CloudPoint& point = cloud.points[i];
    const bool is_near = point.range <= options.near_range;
    for (int k = 0; k < 2; ++k) {
      const bool inside = distances[i] <= (k + 1) * double{point.sigma};
      within[k] += inside;
      near_within[k] += inside && is_near;
    }
    if (is_near) near.push_back(distances[i]);
  }
  const double all_count = static_cast<double>(points.size()), near_count = static_cast<double>(near.size());
  errors.within_sigma = within[0] / all_count;
  errors.within_two_sigma = within[1] / all_count;
  errors.near_within_sigma = near_within[0] / near_count;
  errors.near_within_two_sigma = near_within[1] / near_count;
  errors.distance = spread_of(distances);
  errors.near_distance = spread_of(std::move(near));

  const Neighbourhood neighbourhood(points, options.reach);
  errors.seen = static_cast<int>(seen.size());
  std::vector<int> covered((seen.size() + kGrain - 1) / kGrain);
  parallel_chunks(0, errors.seen, kGrain, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      covered[static_cast<size_t>(begin / kGrain)] += neighbourhood.holds_one_near(seen[static_cast<size_t>(i)]);
    }
  });
  for (const int count : covered) errors.covered += count;
  return errors;
}

}  // namespace iris::evaluate
