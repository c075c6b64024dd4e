// The clouds as PCL's own readers see them.
#include <gtest/gtest.h>
#include <pcl/io/pcd_io.h>
#include <pcl/io/ply_io.h>

#include <cstring>
#include <map>
#include <random>
#include <string>

#include "export/cloud_file.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

PointCloud made_cloud() {
  PointCloud cloud{.edge = 0.025, .points = {}};
  std::mt19937 random(9);
  std::uniform_real_distribution<float> place(-20, 20);
  for (int i = 0; i < 300; ++i) {
    CloudPoint p;
    p.position = {place(random), place(random), place(random)};
    p.normal = Eigen::Vector3f(place(random), place(random), place(random)).normalized();
    p.rgb = {static_cast<uint8_t>(random()), static_cast<uint8_t>(random()), static_cast<uint8_t>(random())};
    p.sigma = std::abs(place(random)) / 1000;
    p.range = std::abs(place(random));
    p.views = static_cast<uint16_t>(1 + random() % 1000);
    cloud.points.push_back(p);
  }
  return cloud;
}

void expect_same(const pcl::PCLPointCloud2& read, const PointCloud& cloud) {
  ASSERT_EQ(read.width * read.height, cloud.points.size());
  std::map<std::string, pcl::PCLPointField> fields;
  for (const pcl::PCLPointField& field : read.fields) fields[field.name] = field;
  for (const char* name : {"x", "y", "z", "normal_x", "normal_y", "normal_z", "rgb", "sigma", "range", "views"}) {
    ASSERT_TRUE(fields.contains(name)) << name;
  }
  const auto number = [&](size_t i, const char* name) {
    float value;
    std::memcpy(&value, &read.data[i * read.point_step + fields[name].offset], sizeof value);
    return value;
  };
  for (size_t i = 0; i < cloud.points.size(); ++i) {
    const CloudPoint& p = cloud.points[i];
    EXPECT_EQ(Eigen::Vector3f(number(i, "x"), number(i, "y"), number(i, "z")), p.position);
    EXPECT_EQ(Eigen::Vector3f(number(i, "normal_x"), number(i, "normal_y"), number(i, "normal_z")), p.normal);
    EXPECT_EQ(number(i, "sigma"), p.sigma);
    EXPECT_EQ(number(i, "range"), p.range);
    uint32_t packed;
    std::memcpy(&packed, &read.data[i * read.point_step + fields["rgb"].offset], sizeof packed);
    EXPECT_EQ(packed & 0xffffff, uint32_t{p.rgb[0]} << 16 | uint32_t{p.rgb[1]} << 8 | p.rgb[2]);
  }
}

TEST(CloudInPcl, HoldsEveryPointWithItsError) {
  const testing::TemporaryFolder temporary;
  const PointCloud cloud = made_cloud();
  for (const bool ascii : {false, true}) {
    write_ply(temporary.path() / "cloud.ply", cloud, ascii);
    pcl::PCLPointCloud2 read;
    ASSERT_EQ(pcl::io::loadPLYFile((temporary.path() / "cloud.ply").string(), read), 0);
    expect_same(read, cloud);
  }
  write_pcd(temporary.path() / "cloud.pcd", cloud);
  pcl::PCLPointCloud2 read;
  ASSERT_EQ(pcl::io::loadPCDFile((temporary.path() / "cloud.pcd").string(), read), 0);
  expect_same(read, cloud);
}

}  // namespace
}  // namespace iris::exporters
