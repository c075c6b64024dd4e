#include "tracer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::simulate {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

// Packets are always full, their last ray repeated.
alignas(64) constexpr int kAllValid[kPacket] = {-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1};

std::shared_ptr<RTCSceneTy> new_scene(RTCDevice device, RTCBuildQuality quality) {
  const RTCScene scene = rtcNewScene(device);
  IRIS_CHECK(scene != nullptr);
  rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);  // no ray slips through between two triangles
  rtcSetSceneBuildQuality(scene, quality);
  return {scene, rtcReleaseScene};
}

// The order of triangles in the tree, and with it which of two triangles wins at their common edge, must not depend on
// how threads share its building.
void commit(RTCScene scene) {
  with_threads(1, [&] { rtcCommitScene(scene); });
}

void attach_mesh(RTCDevice device, RTCScene scene, const TriangleMesh& mesh, int object_idx) {
  const RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* vertices =
      static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                  3 * sizeof(float), std::max<size_t>(1, mesh.vertices.size())));
  auto* indices =
      static_cast<unsigned*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                     3 * sizeof(unsigned), std::max<size_t>(1, mesh.triangles.size())));
  IRIS_CHECK(vertices != nullptr && indices != nullptr);
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    for (int i = 0; i < 3; ++i) *vertices++ = vertex(i);
  }
  for (const Eigen::Vector3i& triangle : mesh.triangles) {
    for (int i = 0; i < 3; ++i) {
      IRIS_CHECK(triangle(i) >= 0 && static_cast<size_t>(triangle(i)) < mesh.vertices.size());
      *indices++ = static_cast<unsigned>(triangle(i));
    }
  }
  rtcCommitGeometry(geometry);
  rtcAttachGeometryByID(scene, geometry, static_cast<unsigned>(object_idx));
  rtcReleaseGeometry(geometry);
}

void attach_instance(RTCDevice device, RTCScene scene, RTCScene part, const Pose& pose) {
  const RTCGeometry instance = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE);
  rtcSetGeometryInstancedScene(instance, part);
  rtcSetGeometryTimeStepCount(instance, 1);
  const Eigen::Matrix<float, 3, 4> transform = pose.matrix().topRows<3>().cast<float>();
  rtcSetGeometryTransform(instance, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, transform.data());
  rtcCommitGeometry(instance);
  rtcAttachGeometry(scene, instance);
  rtcReleaseGeometry(instance);
}

// Neighbouring rays share their way through the tree; but Embree 3.13 was seen not to return from coherent shadow rays
// through instances.
RTCIntersectContext context_for(const Tracer::Moment& moment) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  const bool instances = !moment.world_from_object.empty();
  context.flags = instances ? RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT : RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  return context;
}

}  // namespace

Tracer::Tracer(const Scene& scene) {
  device_ = {rtcNewDevice(nullptr), rtcReleaseDevice};
  IRIS_CHECK(device_ != nullptr);
  still_ = new_scene(device_.get(), RTC_BUILD_QUALITY_HIGH);
  for (size_t i = 0; i < scene.objects.size(); ++i) {
    const SceneObject& object = scene.objects[i];
    const int object_idx = static_cast<int>(i);
    shapes_.push_back({object.mesh.vertices, object.mesh.triangles});
    if (object.mesh.triangles.empty()) continue;
    RTCScene into = still_.get();
    if (object.world_from_object) {
      moving_.push_back({object_idx, object.world_from_object, new_scene(device_.get(), RTC_BUILD_QUALITY_HIGH)});
      into = moving_.back().scene.get();
    }
    attach_mesh(device_.get(), into, object.mesh, object_idx);
    if (object.world_from_object) commit(into);
  }
  commit(still_.get());
  IRIS_CHECK(rtcGetDeviceError(device_.get()) == RTC_ERROR_NONE);
}

Tracer::Moment Tracer::at(double t) const {
  if (moving_.empty()) return {still_, {}};
  Moment moment{new_scene(device_.get(), RTC_BUILD_QUALITY_MEDIUM),
                std::vector<Pose>(shapes_.size(), Pose::Identity())};
  attach_instance(device_.get(), moment.scene.get(), still_.get(), Pose::Identity());
  for (const Moving& moving : moving_) {
    const Pose pose = moving.world_from_object(t);
    moment.world_from_object[static_cast<size_t>(moving.object_idx)] = pose;
    attach_instance(device_.get(), moment.scene.get(), moving.scene.get(), pose);
  }
  commit(moment.scene.get());
  return moment;
}

void Tracer::intersect(const Moment& moment, RTCRayHit16& packet) const {
  RTCIntersectContext context = context_for(moment);
  rtcIntersect16(kAllValid, moment.scene.get(), &context, &packet);
}

void Tracer::trace(const Moment& moment, const Eigen::Vector3d& origin, std::span<const Eigen::Vector3d> directions,
                   std::span<Point> points) const {
  IRIS_CHECK(directions.size() == points.size());
  alignas(64) RTCRayHit16 packet;
  for (size_t begin = 0; begin < directions.size(); begin += kPacket) {
    const size_t count = std::min<size_t>(kPacket, directions.size() - begin);
    for (size_t i = 0; i < kPacket; ++i) {
      const Eigen::Vector3f direction = directions[begin + std::min(i, count - 1)].cast<float>();
      packet.ray.org_x[i] = static_cast<float>(origin.x());
      packet.ray.org_y[i] = static_cast<float>(origin.y());
      packet.ray.org_z[i] = static_cast<float>(origin.z());
      packet.ray.dir_x[i] = direction.x();
      packet.ray.dir_y[i] = direction.y();
      packet.ray.dir_z[i] = direction.z();
      packet.ray.tnear[i] = 0;
      packet.ray.tfar[i] = kInfinity;
      packet.ray.time[i] = 0;
      packet.ray.mask[i] = ~0u;
      packet.ray.flags[i] = 0;
      packet.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
      packet.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
    }
    intersect(moment, packet);
    for (size_t i = 0; i < count; ++i) {
      Point& point = points[begin + i];
      point = Point{};
      if (packet.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID) continue;
      point.object_idx = static_cast<int>(packet.hit.geomID[i]);
      const Shape& shape = shapes_[packet.hit.geomID[i]];
      const Eigen::Vector3i& triangle = shape.triangles[packet.hit.primID[i]];
      Eigen::Vector3d a = shape.vertices[static_cast<size_t>(triangle.x())].cast<double>();
      const Eigen::Vector3d ab = shape.vertices[static_cast<size_t>(triangle.y())].cast<double>() - a;
      const Eigen::Vector3d ac = shape.vertices[static_cast<size_t>(triangle.z())].cast<double>() - a;
      point.normal = ab.cross(ac);
      if (!moment.world_from_object.empty()) {
        const Pose& pose = moment.world_from_object[packet.hit.geomID[i]];
        a = pose * a;
        point.normal = pose.linear() * point.normal;
      }
      const double found = static_cast<double>(packet.ray.tfar[i]);
      const double exact = point.normal.dot(a - origin) / point.normal.dot(directions[begin + i]);
      // A ray almost within the plane says nothing better than what was found.
      point.along = std::abs(exact - found) < 1e-3 * found ? exact : found;
    }
  }
}

void Tracer::hidden(const Moment& moment, const Eigen::Vector3d& from, std::span<const Eigen::Vector3d> points,
                    std::span<uint8_t> result) const {
  IRIS_CHECK(points.size() == result.size());
  // The surface of the point itself is met at 1, within float precision (1e-7 of the coordinates, more at grazing
  // angles).
  constexpr float kBefore = 1 - 2e-4f;
  alignas(64) RTCRay16 packet;
  RTCIntersectContext context = context_for(moment);
  for (size_t begin = 0; begin < points.size(); begin += kPacket) {
    const size_t count = std::min<size_t>(kPacket, points.size() - begin);
    for (size_t i = 0; i < kPacket; ++i) {
      const Eigen::Vector3f direction = (points[begin + std::min(i, count - 1)] - from).cast<float>();
      packet.org_x[i] = static_cast<float>(from.x());
      packet.org_y[i] = static_cast<float>(from.y());
      packet.org_z[i] = static_cast<float>(from.z());
      packet.dir_x[i] = direction.x();
      packet.dir_y[i] = direction.y();
      packet.dir_z[i] = direction.z();
      packet.tnear[i] = 0;
      packet.tfar[i] = kBefore;
      packet.time[i] = 0;
      packet.mask[i] = ~0u;
      packet.flags[i] = 0;
    }
    rtcOccluded16(kAllValid, moment.scene.get(), &context, &packet);
    for (size_t i = 0; i < count; ++i) result[begin + i] = packet.tfar[i] < 0;
  }
}

}  // namespace iris::simulate
