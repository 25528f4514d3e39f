// Plays a MODEL of `clothfit subspace` in C#, without packages: for .NET, Mono and Unity. docs/subspace.md has its arrays.
//
//   var cloth = new Clothfit.Subspace("cape.model.npz");
//   cloth.Step(new float[] { windX, windY, windZ });   // a network's step, under what acts on it: cloth.Raw numbers
//   cloth.Decode();                                    // cloth.Positions: x, y, z of each vertex, m
//   cloth.Shade();                                     // cloth.Normals
//
// Steps of physics are not here: give their coordinates (clothfit subspace play --coordinates) to cloth.Coordinates.
// The Unity package (examples/unity) has a copy of this file, which a test compares: change both.

using System;
using System.Collections.Generic;
using System.IO;
using System.Text;

namespace Clothfit
{
    /// <summary>One object of a model, with its coordinates, positions and normals.</summary>
    public sealed class Subspace
    {
        public readonly int Vertices, Size, Raw, Pins;  // Size: coordinates; Raw: numbers that act on a step
        public readonly int[] Triangles;
        public readonly double[] Coordinates;  // rounding would add up from step to step
        public readonly float[] Positions, Normals;

        readonly float[] basis, start, first, regression;
        readonly int[] way;
        readonly bool smooth;
        readonly float[] linear, offset, range, inputRange, mean, mix;
        readonly double[] before, u;
        readonly List<float[]> weights = new List<float[]>(), biases = new List<float[]>();

        /// <summary>Reads object `number` of a model; throws where there is none.</summary>
        public Subspace(string path, int number = 0)
        {
            Dictionary<string, float[]> all = ReadAll(File.ReadAllBytes(path));
            Func<string, float[]> numbers = name => { float[] found; return all.TryGetValue(name, out found) ? found : null; };
            Func<string, float[]> own = name => numbers(name + number);
            basis = own("basis"); start = own("start"); first = own("before"); regression = own("normals");
            if (basis == null || start == null) throw new InvalidDataException(path + ": it is no model, or an older one");
            way = Array.ConvertAll(own("way"), x => (int)x);
            Triangles = Array.ConvertAll(own("triangles"), x => (int)x);
            Size = first.Length; Vertices = way.Length;
            foreach (int each in way) Pins = Math.Max(Pins, each);
            linear = own("linear"); offset = own("offset"); range = own("range"); inputRange = own("input_range");
            mean = own("signal_mean"); mix = own("signal_mix");
            for (int k = 0; numbers("weight" + number + "." + k) != null; k++)
            {
                weights.Add(numbers("weight" + number + "." + k));
                biases.Add(numbers("bias" + number + "." + k));
            }
            string head = Encoding.UTF8.GetString(Array.ConvertAll(numbers("subspace"), x => (byte)x));
            if (linear != null) smooth = head.Split(new[] { "\"activation\": \"" }, 0)[1 + number].StartsWith("elu");
            Coordinates = new double[Size]; before = new double[Size];
            Positions = (float[])start.Clone(); Normals = new float[3 * Vertices];
            Raw = mean == null ? 0 : mean.Length;
            u = new double[linear == null ? 0 : linear.Length / Size];
            Reset();
        }

        /// <summary>Back to the start.</summary>
        public void Reset()
        {
            Array.Clear(Coordinates, 0, Size);
            Array.Copy(first, before, Size);
        }

        /// <summary>Takes a step of the network under what acts on it, in the order of the model's `signals`.</summary>
        public void Step(params float[] raw)
        {
            if (linear == null) throw new InvalidOperationException("the model steps by physics; give its Coordinates");
            if (raw.Length != Raw) throw new ArgumentException("a step takes " + Raw + " numbers, not " + raw.Length);
            int m = inputRange.Length / 2;
            for (int i = 0; i < Size; i++) { u[i] = Coordinates[i]; u[Size + i] = Coordinates[i] - before[i]; }
            for (int j = 0; j < m; j++)
            {
                double sum = 0;
                for (int i = 0; i < Raw; i++) sum += ((double)raw[i] - mean[i]) * mix[i * m + j];
                u[2 * Size + j] = Math.Min(Math.Max((float)sum, inputRange[j]), inputRange[m + j]);  // as the model has it
            }
            float[] h = Array.ConvertAll(u, x => (float)x);
            for (int k = 0; k < weights.Count; k++)
            {
                h = Times(h, weights[k], biases[k]);
                if (k == weights.Count - 1) break;
                for (int i = 0; i < h.Length; i++)
                    if (h[i] < 0) h[i] = smooth ? (float)Math.Exp(h[i]) - 1f : 0f;
            }
            Array.Copy(Coordinates, before, Size);
            for (int j = 0; j < Size; j++)
            {
                double next = (double)offset[j] + h[j];
                for (int i = 0; i < u.Length; i++) next += u[i] * linear[i * Size + j];
                Coordinates[j] = Math.Min(Math.Max(next, range[j]), range[Size + j]);
            }
        }

        /// <summary>Positions of the coordinates; `pins` are their ways since the start, x, y, z of each, m.</summary>
        public void Decode(float[] pins = null)
        {
            var carried = new float[3];
            for (int p = 0; p < 3 * Pins && pins != null; p++) carried[p % 3] += pins[p] / Pins;
            Apply(basis, Size, 0, Positions);
            for (int i = 0; i < Vertices; i++)
                for (int c = 0; c < 3; c++)
                {
                    Positions[3 * i + c] += start[3 * i + c];
                    if (pins != null && way[i] >= 0) Positions[3 * i + c] += way[i] == 0 ? carried[c] : pins[3 * way[i] - 3 + c];
                }
        }

        /// <summary>Normals: by regression where the model has that, else of the faces at the positions.</summary>
        public void Shade()
        {
            if (regression != null) Apply(regression, Size + 1, 1, Normals);
            else
            {
                Array.Clear(Normals, 0, Normals.Length);
                float[] x = Positions;
                for (int t = 0; t < Triangles.Length; t += 3)
                {
                    int a = 3 * Triangles[t], b = 3 * Triangles[t + 1], c = 3 * Triangles[t + 2];
                    for (int k = 0; k < 3; k++)
                    {
                        int k1 = (k + 1) % 3, k2 = (k + 2) % 3;
                        float n = (x[b + k1] - x[a + k1]) * (x[c + k2] - x[a + k2])
                            - (x[b + k2] - x[a + k2]) * (x[c + k1] - x[a + k1]);
                        Normals[a + k] += n; Normals[b + k] += n; Normals[c + k] += n;
                    }
                }
            }
            for (int i = 0; i < Normals.Length; i += 3)
            {
                double x = Normals[i], y = Normals[i + 1], z = Normals[i + 2], size = Math.Sqrt(x * x + y * y + z * z);
                for (int c = 0; c < 3 && size > 0; c++) Normals[i + c] = (float)(Normals[i + c] / size);
            }
        }

        /// <summary>out = rows · (1, q) with `constant` 1, or rows · q with 0; rows have `columns` numbers each.</summary>
        void Apply(float[] rows, int columns, int constant, float[] result)
        {
            for (int row = 0, at = 0; row < result.Length; row++, at += columns)
            {
                float sum = constant == 1 ? rows[at] : 0f;
                for (int k = 0; k < Size; k++) sum += rows[at + constant + k] * (float)Coordinates[k];
                result[row] = sum;
            }
        }

        static float[] Times(float[] x, float[] matrix, float[] bias)
        {
            var result = (float[])bias.Clone();
            for (int i = 0, at = 0; i < x.Length; i++)
                for (int j = 0; j < result.Length; j++, at++) result[j] += x[i] * matrix[at];
            return result;
        }

        /// <summary>The arrays of a zip archive of .npy files that are stored as they are, by name: from the list at its
        /// end, 46 bytes and a name each.</summary>
        static Dictionary<string, float[]> ReadAll(byte[] data)
        {
            var found = new Dictionary<string, float[]>();
            int end = data.Length - 22;
            while (end > 0 && BitConverter.ToUInt32(data, end) != 0x06054b50) end--;
            if (end <= 0) throw new InvalidDataException("it is no archive");
            for (int i = 0, at = BitConverter.ToInt32(data, end + 16); i < BitConverter.ToUInt16(data, end + 10); i++)
            {
                int length = BitConverter.ToUInt16(data, at + 28), place = BitConverter.ToInt32(data, at + 42);
                if (BitConverter.ToUInt16(data, at + 10) != 0) throw new InvalidDataException("it is packed; use numpy.savez");
                string name = Encoding.UTF8.GetString(data, at + 46, length).Replace(".npy", "");
                int begin = place + 30 + BitConverter.ToUInt16(data, place + 26) + BitConverter.ToUInt16(data, place + 28);
                if (name != "scene") found[name] = Numbers(data, begin, begin + BitConverter.ToInt32(data, at + 24));
                at += 46 + length + BitConverter.ToUInt16(data, at + 30) + BitConverter.ToUInt16(data, at + 32);
            }
            return found;
        }

        static float[] Numbers(byte[] data, int file, int end)
        {
            int begin = file + (data[file + 6] == 1 ? 10 + BitConverter.ToUInt16(data, file + 8) : 12 + BitConverter.ToInt32(data, file + 8));
            string head = Encoding.ASCII.GetString(data, file, begin - file);
            string type = head.Split(new[] { "'descr': '" }, 0)[1].Substring(1, 2);
            int size = type[1] - '0';
            var numbers = new float[(end - begin) / size];
            for (int i = 0, at = begin; i < numbers.Length; i++, at += size)
                numbers[i] = type == "f4" ? BitConverter.ToSingle(data, at) : type == "f8" ? (float)BitConverter.ToDouble(data, at)
                    : type == "f2" ? Half(BitConverter.ToUInt16(data, at)) : type == "i4" ? BitConverter.ToInt32(data, at) : data[at];
            return numbers;
        }

        static float Half(ushort bits)
        {
            int exponent = bits >> 10 & 31, rest = bits & 1023;
            double size = exponent == 0 ? rest * Math.Pow(2, -24) : (1024 + rest) * Math.Pow(2, exponent - 25);
            return (float)(bits >> 15 == 1 ? -size : size);
        }
    }
}
