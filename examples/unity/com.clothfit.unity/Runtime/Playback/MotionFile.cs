using System;
using System.IO;
using System.Text;
using UnityEngine;

namespace Clothfit
{
    /// <summary>
    /// A motion from a PC2 point cache: a header of 32 bytes, then float32 x, y, z of each point in each frame, little
    /// endian. Its axes are right-handed with y up, as clothfit writes them; here x changes its sign, which makes them
    /// Unity's. A frame is read when it is asked for.
    /// </summary>
    public sealed class MotionFile : IDisposable
    {
        const string Magic = "POINTCACHE2\0";
        const int Header = 32, Vector = 12; // bytes

        public readonly int Points, Frames;

        readonly FileStream stream;
        readonly byte[] bytes;

        /// <summary>Opens a file. Throws IOException, and FormatException where it is no PC2.</summary>
        public MotionFile(string path)
        {
            stream = new FileStream(path, FileMode.Open, FileAccess.Read, FileShare.ReadWrite);
            try
            {
                var header = new byte[Header];
                bool whole = Fill(header) && Encoding.ASCII.GetString(header, 0, Magic.Length) == Magic;
                if (!whole || BitConverter.ToInt32(header, 12) != 1) throw new FormatException(path + ": is no PC2 point cache");
                Points = BitConverter.ToInt32(header, 16);
                Frames = BitConverter.ToInt32(header, 28);
                if (Points < 1 || Frames < 1 || Header + (long)Frames * Points * Vector > stream.Length)
                    throw new FormatException(path + ": the file is shorter than its header says");
                bytes = new byte[Points * Vector];
            }
            catch
            {
                stream.Dispose();
                throw;
            }
        }

        /// <summary>Copies the points of a frame from the first on, m, into an array as long as it may be.</summary>
        public void Read(int frame, int first, Vector3[] points)
        {
            stream.Seek(Header + ((long)frame * Points + first) * Vector, SeekOrigin.Begin);
            if (first + points.Length > Points || !Fill(bytes, points.Length * Vector))
                throw new FormatException(stream.Name + ": has " + Points + " points, " + (first + points.Length) + " are asked for");
            for (int i = 0; i < points.Length; i++)
                points[i] = new Vector3(-BitConverter.ToSingle(bytes, Vector * i), BitConverter.ToSingle(bytes, Vector * i + 4),
                    BitConverter.ToSingle(bytes, Vector * i + 8));
        }

        public void Dispose()
        {
            stream.Dispose();
        }

        bool Fill(byte[] into)
        {
            return Fill(into, into.Length);
        }

        bool Fill(byte[] into, int count)
        {
            int done = 0, more;
            while (done < count && (more = stream.Read(into, done, count - done)) > 0) done += more;
            return done == count;
        }
    }
}
