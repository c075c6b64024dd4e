#include "export/cloud_file.h"

#include <fmt/format.h>

#include <bit>
#include <charconv>
#include <cstring>
#include <string>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::exporters {
namespace {

static_assert(std::endian::native == std::endian::little, "binary PLY and PCD are written as they lie in memory");

constexpr const char* kProperties =
    "property float x\nproperty float y\nproperty float z\n"
    "property float nx\nproperty float ny\nproperty float nz\n"
    "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    "property float sigma\nproperty float range\nproperty ushort views\n";
constexpr size_t kRecord = 6 * 4 + 3 + 2 * 4 + 2;  // [bytes] of a binary point

std::string ply_header(const PointCloud& cloud, bool ascii) {
  return fmt::format("ply\nformat {} 1.0\ncomment IRIS " IRIS_VERSION
                     ", metres, z up\ncomment edge {}\nelement vertex {}\n{}end_header\n",
                     ascii ? "ascii" : "binary_little_endian", cloud.edge, cloud.points.size(), kProperties);
}

template <class T>
void append(std::string& bytes, const T& value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof(T));
}

template <class T>
void take(const char*& at, T& value) {
  std::memcpy(static_cast<void*>(&value), at, sizeof(T));
  at += sizeof(T);
}

// The next number of a text; false at its end or where there is none.
template <class T>
bool next_number(const char*& at, const char* end, T& value) {
  while (at < end && (*at == ' ' || *at == '\n' || *at == '\r')) ++at;
  const auto [behind, error] = std::from_chars(at, end, value);
  at = behind;
  return error == std::errc();
}

}  // namespace

void write_ply(const std::filesystem::path& path, const PointCloud& cloud, bool ascii) {
  std::string bytes = ply_header(cloud, ascii);
  bytes.reserve(bytes.size() + cloud.points.size() * (ascii ? 120 : kRecord));
  for (const CloudPoint& p : cloud.points) {
    if (ascii) {
      // The shortest digits that read back as the same float.
      fmt::format_to(std::back_inserter(bytes), "{} {} {} {} {} {} {} {} {} {} {} {}\n", p.position.x(), p.position.y(),
                     p.position.z(), p.normal.x(), p.normal.y(), p.normal.z(), p.rgb[0], p.rgb[1], p.rgb[2], p.sigma,
                     p.range, p.views);
      continue;
    }
    bytes.append(reinterpret_cast<const char*>(p.position.data()), 12);
    bytes.append(reinterpret_cast<const char*>(p.normal.data()), 12);
    append(bytes, p.rgb);
    append(bytes, p.sigma);
    append(bytes, p.range);
    append(bytes, p.views);
  }
  write_file(path, bytes);
}

void write_pcd(const std::filesystem::path& path, const PointCloud& cloud) {
  const size_t count = cloud.points.size();
  std::string bytes = fmt::format(
      "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
      "FIELDS x y z normal_x normal_y normal_z rgb sigma range views\nSIZE 4 4 4 4 4 4 4 4 4 2\n"
      "TYPE F F F F F F F F F U\nCOUNT 1 1 1 1 1 1 1 1 1 1\nWIDTH {}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {}\n"
      "DATA binary\n",
      count, count);
  bytes.reserve(bytes.size() + count * (9 * 4 + 2));
  for (const CloudPoint& p : cloud.points) {
    bytes.append(reinterpret_cast<const char*>(p.position.data()), 12);
    bytes.append(reinterpret_cast<const char*>(p.normal.data()), 12);
    append(bytes, uint32_t{p.rgb[0]} << 16 | uint32_t{p.rgb[1]} << 8 | uint32_t{p.rgb[2]});
    append(bytes, p.sigma);
    append(bytes, p.range);
    append(bytes, p.views);
  }
  write_file(path, bytes);
}

PointCloud read_ply(const std::filesystem::path& path) {
  const std::string bytes = read_file(path);
  const InputError foreign(path, "is no point cloud of 'iris run'", "write it again: iris export OUT --only cloud");
  constexpr std::string_view kEnd = "end_header\n", kEdge = "comment edge ", kVertex = "element vertex ";
  const size_t body = bytes.find(kEnd), edge = bytes.find(kEdge), vertex = bytes.find(kVertex);
  if (body == std::string::npos || edge >= body || vertex >= body) throw foreign;
  PointCloud cloud;
  const char *at = bytes.data() + edge + kEdge.size(), *end = bytes.data() + bytes.size();
  uint64_t count = 0;
  if (!next_number(at, end, cloud.edge)) throw foreign;
  at = bytes.data() + vertex + kVertex.size();
  if (!next_number(at, end, count)) throw foreign;
  const bool ascii = bytes.find("format ascii") < body;
  // The properties are those that write_ply writes, in its order.
  if (!bytes.starts_with("ply\n") || bytes.find(kProperties) >= body) throw foreign;
  at = bytes.data() + body + kEnd.size();
  const size_t left = static_cast<size_t>(end - at);
  if (ascii ? left / (2 * 12) < count : left != count * kRecord) {
    throw InputError(path, "is cut off", "write it again: iris export OUT --only cloud");
  }
  cloud.points.resize(count);
  for (CloudPoint& p : cloud.points) {
    if (!ascii) {
      take(at, p.position);
      take(at, p.normal);
      take(at, p.rgb);
      take(at, p.sigma);
      take(at, p.range);
      take(at, p.views);
      continue;
    }
    bool good = true;
    for (int i = 0; i < 3; ++i) good = good && next_number(at, end, p.position[i]);
    for (int i = 0; i < 3; ++i) good = good && next_number(at, end, p.normal[i]);
    for (int i = 0; i < 3; ++i) good = good && next_number(at, end, p.rgb[i]);
    if (!good || !next_number(at, end, p.sigma) || !next_number(at, end, p.range) || !next_number(at, end, p.views)) {
      throw InputError(path, "is cut off or damaged", "write it again: iris export OUT --only cloud");
    }
  }
  return cloud;
}

}  // namespace iris::exporters
