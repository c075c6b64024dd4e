#include "export/cloud_file.h"

#include <gtest/gtest.h>
#include <pcl/io/pcd_io.h>
#include <pcl/io/ply_io.h>

#include <cstring>
#include <map>
#include <random>
#include <sstream>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

PointCloud made_cloud(int count) {
  PointCloud cloud{.edge = 0.025, .points = {}};
  std::mt19937 random(5);
  std::uniform_real_distribution<float> place(-20, 20);
  for (int i = 0; i < count; ++i) {
    CloudPoint p;
    p.position = {place(random), place(random), place(random)};
    p.normal = Eigen::Vector3f(place(random), place(random), place(random)).normalized();
    p.rgb = {static_cast<uint8_t>(random()), static_cast<uint8_t>(random()), static_cast<uint8_t>(random())};
    p.sigma = std::abs(place(random)) / 1000;
    p.range = std::abs(place(random));
    p.views = static_cast<uint16_t>(random() % 1000);
    cloud.points.push_back(p);
  }
  return cloud;
}

void expect_equal(const PointCloud& a, const PointCloud& b) {
  EXPECT_EQ(a.edge, b.edge);
  ASSERT_EQ(a.points.size(), b.points.size());
  for (size_t i = 0; i < a.points.size(); ++i) {
    EXPECT_EQ(a.points[i].position, b.points[i].position);
    EXPECT_EQ(a.points[i].normal, b.points[i].normal);
    EXPECT_EQ(a.points[i].rgb, b.points[i].rgb);
    EXPECT_EQ(a.points[i].sigma, b.points[i].sigma);
    EXPECT_EQ(a.points[i].range, b.points[i].range);
    EXPECT_EQ(a.points[i].views, b.points[i].views);
  }
}

// The same by the fields that PCL found.
void expect_equal(const pcl::PCLPointCloud2& read, const PointCloud& cloud) {
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

class CloudFile : public ::testing::Test {
 protected:
  const testing::TemporaryFolder temporary_;
  const std::filesystem::path ply_ = temporary_.path() / "cloud.ply", pcd_ = temporary_.path() / "cloud.pcd";
};

TEST_F(CloudFile, ReadsBackWhatWasWritten) {
  for (const bool ascii : {false, true}) {
    for (const int count : {0, 1, 777}) {
      const PointCloud cloud = made_cloud(count);
      write_ply(ply_, cloud, ascii);
      expect_equal(read_ply(ply_), cloud);
    }
  }
}

// The header promises a record for each point; its bytes are decoded here by what the header says.
TEST_F(CloudFile, PcdHoldsWhatItsHeaderSays) {
  const PointCloud cloud = made_cloud(100);
  write_pcd(pcd_, cloud);
  const std::string bytes = read_file(pcd_);
  const std::string last = "DATA binary\n";
  const size_t body = bytes.find(last) + last.size();
  std::map<std::string, std::string> header;
  std::istringstream lines(bytes.substr(0, body));
  for (std::string line; std::getline(lines, line);)
    header[line.substr(0, line.find(' '))] = line.substr(line.find(' ') + 1);
  EXPECT_EQ(header["VERSION"], "0.7");
  EXPECT_EQ(header["POINTS"], "100");
  EXPECT_EQ(header["WIDTH"], "100");
  std::istringstream names(header["FIELDS"]), sizes(header["SIZE"]);
  std::map<std::string, size_t> offsets;
  size_t record = 0;
  std::string name;
  for (size_t size = 0; names >> name && sizes >> size; record += size) offsets[name] = record;
  ASSERT_EQ(bytes.size(), body + 100 * record);
  const auto number = [&](size_t i, const std::string& field) {
    float value = 0;
    std::memcpy(&value, bytes.data() + body + i * record + offsets.at(field), 4);
    return value;
  };
  for (size_t i = 0; i < 100; ++i) {
    const CloudPoint& p = cloud.points[i];
    EXPECT_EQ(number(i, "x"), p.position.x());
    EXPECT_EQ(number(i, "y"), p.position.y());
    EXPECT_EQ(number(i, "z"), p.position.z());
    EXPECT_EQ(number(i, "normal_x"), p.normal.x());
    EXPECT_EQ(number(i, "normal_z"), p.normal.z());
    EXPECT_EQ(number(i, "sigma"), p.sigma);
    EXPECT_EQ(number(i, "range"), p.range);
    uint32_t rgb = 0;
    std::memcpy(&rgb, bytes.data() + body + i * record + offsets.at("rgb"), 4);
    EXPECT_EQ(rgb, uint32_t{p.rgb[0]} << 16 | uint32_t{p.rgb[1]} << 8 | p.rgb[2]);
  }
}

TEST_F(CloudFile, ForeignAndDamagedFilesAreRefused) {
  write_file(ply_, "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n");
  EXPECT_THROW(read_ply(ply_), InputError);
  write_file(ply_, "no cloud at all");
  EXPECT_THROW(read_ply(ply_), InputError);
  EXPECT_THROW(read_ply(temporary_.path() / "missing.ply"), InputError);
  for (const bool ascii : {false, true}) {
    write_ply(ply_, made_cloud(50), ascii);
    const std::string bytes = read_file(ply_);
    write_file(ply_, std::string_view(bytes).substr(0, bytes.size() - 40));
    EXPECT_THROW(read_ply(ply_), InputError) << ascii;
  }
}

TEST_F(CloudFile, AnUnwritablePlaceIsAnError) {
  write_file(temporary_.path() / "file", "");
  EXPECT_THROW(write_ply(temporary_.path() / "file" / "cloud.ply", made_cloud(1)), InputError);
  EXPECT_THROW(write_pcd(temporary_.path() / "file" / "cloud.pcd", made_cloud(1)), InputError);
}

// PCL's own readers find every point with its error.
TEST_F(CloudFile, PclReadsEveryPointWithItsError) {
  const PointCloud cloud = made_cloud(300);
  for (const bool ascii : {false, true}) {
    write_ply(ply_, cloud, ascii);
    pcl::PCLPointCloud2 read;
    ASSERT_EQ(pcl::io::loadPLYFile(ply_.string(), read), 0);
    expect_equal(read, cloud);
  }
  write_pcd(pcd_, cloud);
  pcl::PCLPointCloud2 read;
  ASSERT_EQ(pcl::io::loadPCDFile(pcd_.string(), read), 0);
  expect_equal(read, cloud);
}

}  // namespace
}  // namespace iris::exporters
