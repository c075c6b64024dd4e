#include "iris/session/image_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"

namespace iris::session {
namespace {

using ::testing::HasSubstr;

cv::Mat picture(int type) {
  cv::Mat image(48, 64, type);
  cv::RNG random(5);
  random.fill(image, cv::RNG::UNIFORM, 0, image.depth() == CV_16U ? 65536 : 256);
  cv::GaussianBlur(image, image, {5, 5}, 0);
  return image;
}

class Formats : public ::testing::TestWithParam<const char*> {
 protected:
  std::string written(int type) {
    const auto file = folder_.path() / ("image." + std::string(GetParam()));
    EXPECT_TRUE(cv::imwrite(file.string(), picture(type)));
    return read_file(file);
  }
  // Reads these bytes as a file.
  cv::Mat read(const std::string& bytes) {
    const auto file = folder_.path() / ("again." + std::string(GetParam()));
    write_file(file, bytes);
    return read_image(file);
  }
  iris::testing::TemporaryFolder folder_;
};

TEST_P(Formats, WholeImagesAreRead) {
  const bool lossy = std::string(GetParam()) == "jpg";
  for (const int type : {CV_8UC1, CV_8UC3}) {
    if (type == CV_8UC3 && std::string(GetParam()) == "pgm") continue;
    const cv::Mat image = read(written(type));
    ASSERT_EQ(image.type(), type);
    EXPECT_LE(cv::norm(image, picture(type), cv::NORM_INF), lossy ? 40 : 0);
  }
  EXPECT_NO_THROW(read(written(CV_8UC1) + "\n"));  // a byte more does no harm
}

// Wherever the file ends, it is an error and never a half-grey image.
TEST_P(Formats, CutFilesAreErrors) {
  const std::string bytes = written(CV_8UC1);
  for (size_t kept = 0; kept < bytes.size(); kept += 1 + bytes.size() / 97) {
    EXPECT_THROW(read(bytes.substr(0, kept)), InputError) << kept << " of " << bytes.size();
  }
  // All but TIFF (whose last bytes are a note on its resolution) end with what belongs to the image.
  if (std::string(GetParam()) != "tiff") {
    EXPECT_THROW(read(bytes.substr(0, bytes.size() - 1)), InputError);
  }
}

TEST_P(Formats, OtherContentIsAnError) {
  EXPECT_THROW(read(std::string(5000, 'x')), InputError);
  EXPECT_THROW(read("<html>404</html>"), InputError);
}

INSTANTIATE_TEST_SUITE_P(All, Formats, ::testing::Values("png", "jpg", "pgm", "tiff", "bmp"),
                         [](const auto& test) { return std::string(test.param); });

TEST(ReadImage, DamagedPngIsAnError) {
  iris::testing::TemporaryFolder folder;
  const auto file = folder.path() / "image.png";
  cv::imwrite(file.string(), picture(CV_8UC1));
  std::string bytes = read_file(file);
  for (size_t i = 0; i < 8; ++i) bytes[bytes.size() / 2 + i] ^= 0x55;
  write_file(file, bytes);
  EXPECT_THROW(read_image(file), InputError);
}

TEST(ReadImage, ProgressiveJpegAndThumbnails) {
  iris::testing::TemporaryFolder folder;
  const auto file = folder.path() / "image.jpg";
  cv::imwrite(file.string(), picture(CV_8UC3), {cv::IMWRITE_JPEG_PROGRESSIVE, 1});
  EXPECT_NO_THROW(read_image(file));
  // An application segment with an end marker in it, as thumbnails have, before a cut image.
  std::string bytes = read_file(file);
  bytes.insert(2, std::string("\xff\xe1\x00\x06\xff\xd9\x00\x00", 8));
  write_file(file, bytes);
  EXPECT_NO_THROW(read_image(file));
  write_file(file, bytes.substr(0, bytes.size() / 2));
  EXPECT_THROW(read_image(file), InputError);
}

TEST(ReadImage, AlphaIsDroppedAndSixteenBitsAreKept) {
  iris::testing::TemporaryFolder folder;
  const auto file = folder.path() / "image.png";
  cv::imwrite(file.string(), cv::Mat(4, 4, CV_8UC4, cv::Scalar(1, 2, 3, 0)));
  cv::Mat image = read_image(file);
  ASSERT_EQ(image.type(), CV_8UC3);
  EXPECT_EQ(image.at<cv::Vec3b>(2, 2), cv::Vec3b(1, 2, 3));
  cv::imwrite(file.string(), cv::Mat(4, 4, CV_16UC1, cv::Scalar(40000)));
  image = read_image(file);
  ASSERT_EQ(image.type(), CV_16UC1);
  EXPECT_EQ(image.at<ushort>(1, 1), 40000);
}

TEST(ReadImage, NamesTheFile) {
  try {
    read_image("/nowhere/at_all.png");
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("/nowhere/at_all.png"));
  }
}

TEST(Bits, SmallestThatHolds) {
  EXPECT_EQ(used_bits(200), 8);
  EXPECT_EQ(used_bits(255), 8);
  EXPECT_EQ(used_bits(256), 10);
  EXPECT_EQ(used_bits(4095), 12);
  EXPECT_EQ(used_bits(4096), 14);
  EXPECT_EQ(used_bits(65535), 16);
}

TEST(Bits, OneFactorRoundedAndSaturated) {
  const cv::Mat1w image = (cv::Mat1w(1, 5) << 0, 16, 23, 25, 4095);
  const cv::Mat1b result = to_8_bit(image, 12);
  const cv::Mat1b expected = (cv::Mat1b(1, 5) << 0, 1, 1, 2, 255);
  EXPECT_EQ(cv::norm(result, expected, cv::NORM_INF), 0);
  EXPECT_EQ(to_8_bit(cv::Mat1w(1, 1, 60000), 12).at<uchar>(0), 255);
}

TEST(ImageNames, HiddenFilesAndOthersAreNoImages) {
  EXPECT_TRUE(is_image_file("a/000000.PNG"));
  EXPECT_TRUE(is_image_file("x.jpeg"));
  EXPECT_FALSE(is_image_file("a/._000000.png"));
  EXPECT_FALSE(is_image_file("Thumbs.db"));
}

}  // namespace
}  // namespace iris::session
