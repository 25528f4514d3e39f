// Vectors, rotations, colours and the attributes of UnityEngine, as far as the package uses them.

using System;

namespace UnityEngine
{
    public struct Vector2
    {
        public float x, y;

        public Vector2(float x, float y)
        {
            this.x = x;
            this.y = y;
        }

        public static Vector2 zero
        {
            get { return new Vector2(0f, 0f); }
        }
    }

    public struct Vector3 : IEquatable<Vector3>
    {
        public float x, y, z;

        public Vector3(float x, float y, float z)
        {
            this.x = x;
            this.y = y;
            this.z = z;
        }

        public static Vector3 zero
        {
            get { return new Vector3(0f, 0f, 0f); }
        }

        public static Vector3 one
        {
            get { return new Vector3(1f, 1f, 1f); }
        }

        public float magnitude
        {
            get { return (float)Math.Sqrt((double)x * x + (double)y * y + (double)z * z); }
        }

        public static Vector3 operator +(Vector3 a, Vector3 b)
        {
            return new Vector3(a.x + b.x, a.y + b.y, a.z + b.z);
        }

        public static Vector3 operator -(Vector3 a, Vector3 b)
        {
            return new Vector3(a.x - b.x, a.y - b.y, a.z - b.z);
        }

        public static Vector3 operator -(Vector3 a)
        {
            return new Vector3(-a.x, -a.y, -a.z);
        }

        public static Vector3 operator *(Vector3 a, float factor)
        {
            return new Vector3(a.x * factor, a.y * factor, a.z * factor);
        }

        public static Vector3 operator *(float factor, Vector3 a)
        {
            return a * factor;
        }

        public static Vector3 Scale(Vector3 a, Vector3 b)
        {
            return new Vector3(a.x * b.x, a.y * b.y, a.z * b.z);
        }

        public static Vector3 Cross(Vector3 a, Vector3 b)
        {
            return new Vector3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
        }

        /// <summary>Unity takes vectors that are nearly the same for equal here, and not in Equals.</summary>
        public static bool operator ==(Vector3 a, Vector3 b)
        {
            Vector3 d = a - b;
            return d.x * d.x + d.y * d.y + d.z * d.z < 9.99999944e-11f;
        }

        public static bool operator !=(Vector3 a, Vector3 b)
        {
            return !(a == b);
        }

        public bool Equals(Vector3 other)
        {
            return x == other.x && y == other.y && z == other.z;
        }

        public override bool Equals(object other)
        {
            return other is Vector3 && Equals((Vector3)other);
        }

        public override int GetHashCode()
        {
            return x.GetHashCode() ^ (y.GetHashCode() << 2) ^ (z.GetHashCode() >> 2);
        }
    }

    /// <summary>A rotation, as a matrix of doubles. Euler angles are about z, then x, then y, degrees.</summary>
    public struct Quaternion
    {
        readonly double[,] matrix;

        Quaternion(double[,] matrix)
        {
            this.matrix = matrix;
        }

        public static Quaternion identity
        {
            get { return Euler(0f, 0f, 0f); }
        }

        public static Quaternion Euler(float x, float y, float z)
        {
            return About(1, y) * About(0, x) * About(2, z);
        }

        public static Quaternion Inverse(Quaternion rotation)
        {
            var turned = new double[3, 3];
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) turned[i, j] = rotation.matrix[j, i];
            return new Quaternion(turned);
        }

        public Vector3 eulerAngles
        {
            get
            {
                double x = Math.Asin(Math.Max(-1, Math.Min(1, -matrix[1, 2])));
                double y = Math.Atan2(matrix[0, 2], matrix[2, 2]), z = Math.Atan2(matrix[1, 0], matrix[1, 1]);
                return new Vector3(Degrees(x), Degrees(y), Degrees(z));
            }
        }

        static float Degrees(double angle)
        {
            return (float)((angle * 180 / Math.PI + 360) % 360);
        }

        static Quaternion About(int axis, double degrees)
        {
            double angle = degrees * Math.PI / 180, c = Math.Cos(angle), s = Math.Sin(angle);
            int i = (axis + 1) % 3, j = (axis + 2) % 3;
            var m = new double[3, 3];
            m[axis, axis] = 1;
            m[i, i] = m[j, j] = c;
            m[j, i] = s;
            m[i, j] = -s;
            return new Quaternion(m);
        }

        public static Quaternion operator *(Quaternion a, Quaternion b)
        {
            var m = new double[3, 3];
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++)
                    for (int k = 0; k < 3; k++) m[i, j] += a.matrix[i, k] * b.matrix[k, j];
            return new Quaternion(m);
        }

        public static Vector3 operator *(Quaternion a, Vector3 v)
        {
            double[,] m = a.matrix;
            return new Vector3((float)(m[0, 0] * v.x + m[0, 1] * v.y + m[0, 2] * v.z),
                (float)(m[1, 0] * v.x + m[1, 1] * v.y + m[1, 2] * v.z), (float)(m[2, 0] * v.x + m[2, 1] * v.y + m[2, 2] * v.z));
        }
    }

    public struct Matrix4x4
    {
        public static Matrix4x4 identity
        {
            get { return new Matrix4x4(); }
        }
    }

    public struct Color
    {
        public float r, g, b, a;

        public Color(float r, float g, float b, float a = 1f)
        {
            this.r = r;
            this.g = g;
            this.b = b;
            this.a = a;
        }

        public static Color blue
        {
            get { return new Color(0f, 0f, 1f); }
        }

        public static Color green
        {
            get { return new Color(0f, 1f, 0f); }
        }

        public static Color red
        {
            get { return new Color(1f, 0f, 0f); }
        }

        public static Color cyan
        {
            get { return new Color(0f, 1f, 1f); }
        }

        public static Color grey
        {
            get { return new Color(0.5f, 0.5f, 0.5f); }
        }

        public static Color Lerp(Color a, Color b, float t)
        {
            t = Mathf.Clamp01(t);
            return new Color(a.r + (b.r - a.r) * t, a.g + (b.g - a.g) * t, a.b + (b.b - a.b) * t, a.a + (b.a - a.a) * t);
        }
    }

    public static class Mathf
    {
        public static float Abs(float value)
        {
            return Math.Abs(value);
        }

        public static float Max(float a, float b)
        {
            return Math.Max(a, b);
        }

        public static float Min(float a, float b)
        {
            return Math.Min(a, b);
        }

        public static int Max(int a, int b)
        {
            return Math.Max(a, b);
        }

        public static int Min(int a, int b)
        {
            return Math.Min(a, b);
        }

        public static int Clamp(int value, int low, int high)
        {
            return Math.Min(Math.Max(value, low), high);
        }

        public static float Clamp01(float value)
        {
            return Math.Min(Math.Max(value, 0f), 1f);
        }

        public static int RoundToInt(float value)
        {
            return (int)Math.Round(value);
        }

        public static int FloorToInt(float value)
        {
            return (int)Math.Floor(value);
        }
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class SerializeField : Attribute
    {
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class TooltipAttribute : Attribute
    {
        public readonly string tooltip;

        public TooltipAttribute(string tooltip)
        {
            this.tooltip = tooltip;
        }
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class HeaderAttribute : Attribute
    {
        public HeaderAttribute(string header)
        {
        }
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class MinAttribute : Attribute
    {
        public MinAttribute(float min)
        {
        }
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class RangeAttribute : Attribute
    {
        public RangeAttribute(float min, float max)
        {
        }
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class HideInInspector : Attribute
    {
    }

    [AttributeUsage(AttributeTargets.Class)]
    public sealed class AddComponentMenu : Attribute
    {
        public AddComponentMenu(string menuName)
        {
        }
    }

    [AttributeUsage(AttributeTargets.Class)]
    public sealed class DisallowMultipleComponent : Attribute
    {
    }

    [AttributeUsage(AttributeTargets.Class)]
    public sealed class ExecuteAlways : Attribute
    {
    }

    [AttributeUsage(AttributeTargets.Class)]
    public sealed class RequireComponent : Attribute
    {
        public readonly Type Required;

        public RequireComponent(Type required)
        {
            Required = required;
        }
    }

    [AttributeUsage(AttributeTargets.Method)]
    public sealed class ContextMenu : Attribute
    {
        public ContextMenu(string itemName)
        {
        }
    }
}

namespace UnityEngine.Rendering
{
    public enum IndexFormat
    {
        UInt16,
        UInt32,
    }
}
