// Rays through the scene: Embree finds the triangle, double precision says where it is met.
#pragma once

#include <embree3/rtcore.h>

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "iris/simulate/scene.h"

namespace iris::simulate {

inline constexpr int kPacket = 16;  // rays that are traced together

class Tracer {
 public:
  explicit Tracer(const Scene& scene);

  // All objects where they are at one time. Any number of threads may trace the same or different moments.
  struct Moment {
    std::shared_ptr<RTCSceneTy> scene;
    std::vector<Pose> world_from_object;  // one an object; empty if all stand still
  };
  Moment at(double t) const;

  bool all_still() const { return moving_.empty(); }

  // Where the rays of a full packet meet surfaces. The geomID of a hit is the index of the object in the scene.
  void intersect(const Moment& moment, RTCRayHit16& packet) const;

  struct Point {
    int object_idx = -1;                               // -1 = sky
    double along = 0;                                  // in lengths of the direction
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // in the world, of any length, of either side
  };
  // One ray for each direction, all from `origin` [m]. The float position that Embree finds is replaced by the exact
  // meeting of the ray with the plane of the triangle.
  void trace(const Moment& moment, const Eigen::Vector3d& origin, std::span<const Eigen::Vector3d> directions,
             std::span<Point> points) const;

  // 1 where something stands between `from` and the point (itself on a surface, which does not count), else 0.
  void hidden(const Moment& moment, const Eigen::Vector3d& from, std::span<const Eigen::Vector3d> points,
              std::span<uint8_t> result) const;

 private:
  struct Shape {
    std::vector<Eigen::Vector3f> vertices;
    std::vector<Eigen::Vector3i> triangles;
  };
  struct Moving {
    int object_idx = 0;
    std::function<Pose(double t)> world_from_object;
    std::shared_ptr<RTCSceneTy> scene;
  };

  std::shared_ptr<RTCDeviceTy> device_;
  std::vector<Shape> shapes_;          // one an object
  std::shared_ptr<RTCSceneTy> still_;  // all objects that stand still
  std::vector<Moving> moving_;
};

}  // namespace iris::simulate
