// Objects, components, transforms, meshes and gizmos of UnityEngine, as far as the package uses them.

using System;
using System.Collections.Generic;
using System.Linq;
using System.Reflection;
using UnityEngine.Rendering;

namespace UnityEngine
{
    [Flags]
    public enum HideFlags
    {
        None = 0,
        DontSave = 52,
    }

    public class Object
    {
        internal static readonly List<Object> Alive = new List<Object>();
        bool destroyed;
        string own = "";

        public HideFlags hideFlags;

        public Object()
        {
            Alive.Add(this);
        }

        /// <summary>A component has the name of its object.</summary>
        public string name
        {
            get { return this is Component ? ((Component)this).gameObject.own : own; }
            set { own = value; }
        }

        public static T Instantiate<T>(T original) where T : Object
        {
            return (T)original.Copy();
        }

        public static void Destroy(Object it)
        {
            it.destroyed = true;
            Alive.Remove(it);
        }

        public static void DestroyImmediate(Object it)
        {
            Destroy(it);
        }

        /// <summary>What is destroyed counts as null.</summary>
        public static bool operator ==(Object a, Object b)
        {
            bool none = ReferenceEquals(a, null) || a.destroyed, neither = ReferenceEquals(b, null) || b.destroyed;
            return none || neither ? none && neither : ReferenceEquals(a, b);
        }

        public static bool operator !=(Object a, Object b)
        {
            return !(a == b);
        }

        public override bool Equals(object other)
        {
            return this == (other as Object);
        }

        public override int GetHashCode()
        {
            return System.Runtime.CompilerServices.RuntimeHelpers.GetHashCode(this);
        }

        protected virtual Object Copy()
        {
            throw new NotSupportedException("the stand-in copies meshes only");
        }
    }

    public sealed class GameObject : Object
    {
        readonly List<Component> components = new List<Component>();

        public GameObject(string name, params Type[] components)
        {
            this.name = name;
            transform = (Transform)Add(typeof(Transform));
            foreach (Type each in components) Add(each);
        }

        public Transform transform { get; private set; }

        public T AddComponent<T>() where T : Component
        {
            return (T)Add(typeof(T));
        }

        public T GetComponent<T>() where T : Component
        {
            return components.OfType<T>().FirstOrDefault(each => each != null);
        }

        public T GetComponentInParent<T>() where T : Component
        {
            T own = GetComponent<T>();
            return own != null || transform.parent == null ? own : transform.parent.gameObject.GetComponentInParent<T>();
        }

        public T[] GetComponentsInChildren<T>() where T : Component
        {
            return Below<T>().ToArray();
        }

        internal IEnumerable<T> Below<T>() where T : Component
        {
            return components.OfType<T>().Concat(transform.Children.SelectMany(each => each.gameObject.Below<T>()));
        }

        /// <summary>Adds a component after what it requires; the editor calls its Reset.</summary>
        internal Component Add(Type type)
        {
            for (Type each = type; each != null; each = each.BaseType)
                foreach (RequireComponent need in each.GetCustomAttributes(typeof(RequireComponent), false))
                    if (!components.Any(need.Required.IsInstanceOfType)) Add(need.Required);
            var added = (Component)Activator.CreateInstance(type, true);
            added.gameObject = this;
            components.Add(added);
            Messages.Send(added, "Reset");
            return added;
        }
    }

    /// <summary>Calls of methods that Unity finds by their names.</summary>
    public static class Messages
    {
        public static void Send(Object to, string name)
        {
            MethodInfo method = to.GetType().GetMethod(name, BindingFlags.Instance | BindingFlags.Public | BindingFlags.NonPublic);
            if (method != null) method.Invoke(to, null);
        }
    }

    public class Component : Object
    {
        public GameObject gameObject { get; internal set; }

        public Transform transform
        {
            get { return gameObject.transform; }
        }

        public T GetComponent<T>() where T : Component
        {
            return gameObject.GetComponent<T>();
        }

        public T[] GetComponentsInChildren<T>() where T : Component
        {
            return gameObject.Below<T>().ToArray();
        }
    }

    public class Behaviour : Component
    {
        public bool enabled = true;
    }

    public class MonoBehaviour : Behaviour
    {
    }

    public sealed class MeshRenderer : Component
    {
    }

    public sealed class MeshFilter : Component
    {
        public Mesh sharedMesh;
    }

    public sealed class Transform : Component
    {
        internal readonly List<Transform> Children = new List<Transform>();

        public Transform parent { get; private set; }

        public Vector3 localPosition = Vector3.zero, localScale = Vector3.one;
        public Quaternion localRotation = Quaternion.identity;

        public Vector3 position
        {
            get { return parent == null ? localPosition : parent.TransformPoint(localPosition); }
            set { localPosition = parent == null ? value : parent.InverseTransformPoint(value); }
        }

        public Quaternion rotation
        {
            get { return parent == null ? localRotation : parent.rotation * localRotation; }
        }

        public Vector3 eulerAngles
        {
            get { return rotation.eulerAngles; }
        }

        public Vector3 lossyScale
        {
            get { return parent == null ? localScale : Vector3.Scale(parent.lossyScale, localScale); }
        }

        public Matrix4x4 localToWorldMatrix
        {
            get { return Matrix4x4.identity; }
        }

        public void SetParent(Transform to, bool worldPositionStays)
        {
            if (worldPositionStays) throw new NotSupportedException("the stand-in keeps local places");
            if (parent != null) parent.Children.Remove(this);
            parent = to;
            to.Children.Add(this);
        }

        public Transform Find(string name)
        {
            return Children.FirstOrDefault(each => each.name == name);
        }

        public Vector3 TransformPoint(Vector3 place)
        {
            Vector3 outside = localPosition + localRotation * Vector3.Scale(localScale, place);
            return parent == null ? outside : parent.TransformPoint(outside);
        }

        public Vector3 InverseTransformPoint(Vector3 place)
        {
            Vector3 turned = Quaternion.Inverse(localRotation)
                * ((parent == null ? place : parent.InverseTransformPoint(place)) - localPosition);
            return new Vector3(turned.x / localScale.x, turned.y / localScale.y, turned.z / localScale.z);
        }

        public Vector3 InverseTransformDirection(Vector3 direction)
        {
            return Quaternion.Inverse(rotation) * direction;
        }

        public Vector3 TransformDirection(Vector3 direction)
        {
            return rotation * direction;
        }
    }

    /// <summary>As Unity's, all arrays are copies.</summary>
    public sealed class Mesh : Object
    {
        Vector3[] places = new Vector3[0], perpendiculars = new Vector3[0];
        Vector2[] texture = new Vector2[0];
        int[] corners = new int[0];

        public IndexFormat indexFormat;

        public Vector3[] vertices
        {
            get { return (Vector3[])places.Clone(); }
            set { places = (Vector3[])value.Clone(); }
        }

        public Vector3[] normals
        {
            get { return (Vector3[])perpendiculars.Clone(); }
            set { perpendiculars = (Vector3[])value.Clone(); }
        }

        public Vector2[] uv
        {
            get { return (Vector2[])texture.Clone(); }
            set
            {
                if (value.Length != places.Length) throw new ArgumentException("as many as vertices");
                texture = (Vector2[])value.Clone();
            }
        }

        public int[] triangles
        {
            get { return (int[])corners.Clone(); }
            set
            {
                if (value.Length % 3 != 0 || value.Any(each => each < 0 || each >= places.Length))
                    throw new ArgumentException("corners are threes of vertices");
                if (indexFormat == IndexFormat.UInt16 && places.Length > 65535) throw new ArgumentException("needs UInt32");
                corners = (int[])value.Clone();
            }
        }

        public void RecalculateNormals()
        {
            perpendiculars = new Vector3[places.Length];
            for (int k = 0; k < corners.Length; k += 3)
            {
                Vector3 a = places[corners[k]], n = Vector3.Cross(places[corners[k + 1]] - a, places[corners[k + 2]] - a);
                for (int i = k; i < k + 3; i++) perpendiculars[corners[i]] += n;
            }
            perpendiculars = perpendiculars.Select(n => n * (1f / n.magnitude)).ToArray();
        }

        public void RecalculateBounds()
        {
        }

        protected override Object Copy()
        {
            return new Mesh { places = vertices, corners = triangles, texture = uv, perpendiculars = normals };
        }
    }

    /// <summary>Keeps what is drawn.</summary>
    public static class Gizmos
    {
        public struct Line
        {
            public Vector3 From, To;
            public Color Colour;
        }

        public static readonly List<Line> Lines = new List<Line>();
        public static Color color;
        public static Matrix4x4 matrix;

        public static void DrawLine(Vector3 from, Vector3 to)
        {
            Lines.Add(new Line { From = from, To = to, Colour = color });
        }

        public static void DrawRay(Vector3 from, Vector3 direction)
        {
            DrawLine(from, from + direction);
        }

        public static void DrawWireCube(Vector3 center, Vector3 size)
        {
        }

        public static void DrawWireSphere(Vector3 center, float radius)
        {
        }
    }

    /// <summary>Keeps what is said.</summary>
    public static class Debug
    {
        public static readonly List<string> Said = new List<string>(), Faults = new List<string>();

        public static void Log(object message)
        {
            Said.Add(message.ToString());
        }

        public static void LogError(object message)
        {
            Faults.Add(message.ToString());
        }

        public static void LogError(object message, Object context)
        {
            LogError(message);
        }
    }

    public static class Application
    {
        public static string dataPath = "";
        public static bool isPlaying;
    }

    public static class Time
    {
        public static float deltaTime;
    }

    public sealed class GUIContent
    {
        public GUIContent(string text, string tooltip)
        {
        }
    }

    public static class GUILayout
    {
        public static bool Button(string text)
        {
            return false;
        }
    }
}

namespace UnityEngine.SceneManagement
{
    /// <summary>What is alive, as the only open scene.</summary>
    public struct Scene
    {
        public bool isLoaded { get { return true; } }

        public GameObject[] GetRootGameObjects()
        {
            return Object.Alive.OfType<GameObject>().Where(each => each.transform.parent == null).ToArray();
        }
    }

    public static class SceneManager
    {
        public const int sceneCount = 1;

        public static Scene GetSceneAt(int index)
        {
            return new Scene();
        }
    }
}
